"""The fault detector: checks one sample of all tendons."""

from collections.abc import Sequence
from math import isfinite
from typing import Annotated

from estimator.compiled import jit_compile
from estimator.online.online import TendonModel
from estimator.structs import Field, Struct, StructArray, view_struct
from slave.fault_detection.config import FaultDetectionConfig
from slave.fault_detection.load_cell import check_cell, is_suspect, update_average
from slave.fault_detection.wound_length import (
    CheckedTendon,
    WindingCheck,
    check_slack,
    check_winding,
    compute_compliance,
)
from slave.rig_layout import EstimatedTendon, RigLayout, TendonGroup
from teleop.messages.messages import MAX_JOINTS, MAX_TENDONS
from teleop.session.state_machine import Reason


class FaultDetector(Struct):
    """Constants and state of the fault detection of a rig."""

    tendon: Annotated[Sequence[CheckedTendon], Field(CheckedTendon, MAX_TENDONS)]
    # of each group of tendons; unused for a single one
    winding: Annotated[Sequence[WindingCheck], Field(WindingCheck, MAX_JOINTS)]


def init_detector(models: Sequence[TendonModel]) -> StructArray:
    """Return the detector before the first sample, from the tendons' models, shape (1,)."""
    detector = FaultDetector.array()
    record = view_struct(detector)
    for tendon, model in zip(record.tendon, models, strict=False):
        tendon.compliance = compute_compliance(model.sheath)
        tendon.noise = model.tension_noise
    return detector


@jit_compile
def step(
    config: FaultDetectionConfig,
    layout: RigLayout,
    detector: FaultDetector,
    tendons: Sequence[EstimatedTendon],
    dt: float,
) -> tuple[Reason, int]:
    """Check one sample of the rig; return the fault found and its tendon.

    The tendon is counted over the whole rig from 0; `Reason.NONE` and -1 without a fault. Of
    several faults the first is returned: load cells by tendon, then group by group. The sample, as
    measured, is `dt` [s] after the one before; tendons that are not valid are skipped. `detector`
    is changed in place.
    """
    dt = dt if dt > 0.0 else 0.0
    fault, tendon = Reason.NONE, -1
    for i in range(layout.tendons):
        if tendons[i].valid:
            checks, T, q = detector.tendon[i], tendons[i].tension, tendons[i].displacement
            reason = check_cell(config, checks.noise, checks.cell, T, q, dt)
            update_average(checks.average, T, q, dt)
            if fault == Reason.NONE and reason != Reason.NONE:
                fault, tendon = reason, i
    for g in range(layout.groups):
        group = layout.group[g]
        if _is_testable(group, detector, tendons):
            reason, i = _check_group(config, group, detector, detector.winding[g], tendons, dt)
            if fault == Reason.NONE and reason != Reason.NONE:
                fault, tendon = reason, i
    return fault, tendon


@jit_compile
def _is_testable(
    group: TendonGroup, detector: FaultDetector, tendons: Sequence[EstimatedTendon]
) -> bool:
    """Return whether position and tension of all tendons of a group are known."""
    for n in range(group.count):
        i = group.tendon[n]
        checks = detector.tendon[i]
        is_measured = tendons[i].valid and isfinite(tendons[i].displacement)
        if not is_measured or is_suspect(checks.cell, checks.noise):
            return False
    return True


@jit_compile
def _check_group(
    config: FaultDetectionConfig,
    group: TendonGroup,
    detector: FaultDetector,
    winding: WindingCheck,
    tendons: Sequence[EstimatedTendon],
    dt: float,
) -> tuple[Reason, int]:
    """Return the fault found in the tendons of a group, and the index of the tendon."""
    wound = 0.0
    for n in range(group.count):
        wound += group.balance[n] * detector.tendon[group.tendon[n]].average.displacement
    fault, tendon = Reason.NONE, -1
    for n in range(group.count):
        i = group.tendon[n]
        checks, own = detector.tendon[i], wound / group.balance[n]
        tension_before = checks.average.tension
        broken = check_slack(config, checks.slack, tendons[i].tension, tension_before, own, dt)
        if broken and fault == Reason.NONE:
            fault, tendon = Reason.TENDON_BROKEN, i
    if group.count > 1:
        reason, i = check_winding(config, winding, detector.tendon, group, dt)
        if fault == Reason.NONE and reason != Reason.NONE:
            fault, tendon = reason, i
    return fault, tendon
