"""The fault detector: checks one sample of all tendons."""

from collections.abc import Sequence
from math import isfinite
from typing import Annotated

from estimator.compiled import jit_compile
from estimator.online.online import TendonModel
from estimator.records import Field, Struct, StructArray, view_struct
from slave.fault_detection.cell import check_cell, is_suspect, update_average
from slave.fault_detection.config import FaultDetectionConfig
from slave.fault_detection.wound_length import (
    CheckedTendon,
    WindingCheck,
    check_slack,
    check_winding,
    compute_compliance,
)
from slave.tendons import EstimatedTendon, JointTendons, RigLayout
from teleop.messages.messages import MAX_JOINTS, MAX_TENDONS
from teleop.session.state_machine import Reason


class FaultDetector(Struct):
    """Constants and state of the fault detection of a rig."""

    tendon: Annotated[Sequence[CheckedTendon], Field(CheckedTendon, MAX_TENDONS)]
    # of each joint; unused for a single tendon
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
    several faults the first is returned: load cells by tendon, then joint by joint.

    Parameters
    ----------
    detector : FaultDetector
        From `init_detector`, changed in place.
    tendons : array of EstimatedTendon
        The sample, as measured. Tendons that are not valid are skipped.
    dt : float
        Time since the sample before [s].
    """
    dt = dt if dt > 0.0 else 0.0
    fault, tendon = Reason.NONE, -1
    for i in range(layout.tendons):
        if tendons[i].valid:
            reason = _check_tendon(config, detector.tendon[i], tendons[i], dt)
            if fault == Reason.NONE and reason != Reason.NONE:
                fault, tendon = reason, i
    for k in range(layout.joints):
        joint = layout.joint[k]
        if _is_testable(joint, detector, tendons):
            reason, i = _check_joint(config, joint, detector, detector.winding[k], tendons, dt)
            if fault == Reason.NONE and reason != Reason.NONE:
                fault, tendon = reason, i
    return fault, tendon


@jit_compile
def _check_tendon(
    config: FaultDetectionConfig, checks: CheckedTendon, tendon: EstimatedTendon, dt: float
) -> Reason:
    """Process the readings of one tendon; return the fault of its load cell."""
    T, q = tendon.tension, tendon.displacement
    reason = check_cell(config, checks.noise, checks.cell, T, q, dt)
    update_average(checks.average, T, q, dt)
    return reason


@jit_compile
def _is_testable(
    joint: JointTendons, detector: FaultDetector, tendons: Sequence[EstimatedTendon]
) -> bool:
    """Return whether position and tension of all tendons of a joint are known."""
    for m in range(joint.count):
        i = joint.tendon[m]
        checks = detector.tendon[i]
        is_measured = tendons[i].valid and isfinite(tendons[i].displacement)
        if not is_measured or is_suspect(checks.cell, checks.noise):
            return False
    return True


@jit_compile
def _check_joint(
    config: FaultDetectionConfig,
    joint: JointTendons,
    detector: FaultDetector,
    winding: WindingCheck,
    tendons: Sequence[EstimatedTendon],
    dt: float,
) -> tuple[Reason, int]:
    """Return the fault found in the tendons of a joint, and the index of the tendon."""
    wound = 0.0
    for m in range(joint.count):
        wound += detector.tendon[joint.tendon[m]].average.displacement
    fault, tendon = Reason.NONE, -1
    for m in range(joint.count):
        i = joint.tendon[m]
        checks = detector.tendon[i]
        tension_before = checks.average.tension
        broken = check_slack(config, checks.slack, tendons[i].tension, tension_before, wound, dt)
        if broken and fault == Reason.NONE:
            fault, tendon = Reason.TENDON_BROKEN, i
    if joint.count > 1:
        a, b = detector.tendon[joint.tendon[0]], detector.tendon[joint.tendon[1]]
        reason, m = check_winding(config, winding, a, b, dt)
        if fault == Reason.NONE and reason != Reason.NONE:
            fault, tendon = reason, joint.tendon[m]
    return fault, tendon
