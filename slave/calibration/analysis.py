"""Evaluate the record of an initialisation, joint by joint: pure functions.

Each tendon is calibrated by its own pulls and releases (`slave.calibration.direction`); the two of
a joint are then corrected with the drags (`slave.calibration.drags`).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from slave.calibration.config import InitialiseConfig, get_known_sheath
from slave.calibration.direction import (
    build_tendon_calibration,
    calibrate_tendon,
    round_significant,
)
from slave.calibration.drags import combine_with_drags
from slave.calibration.file import TendonCalibration
from slave.calibration.procedure_state import Phase
from slave.calibration.pulled import PulledTendon
from slave.calibration.run import CalibrationRefused, ProcedureData
from slave.tendon_config import TendonConfig

RANGE_MIN = 0.001  # [m] of a joint that moves
RANGE_DIFFERENCE_MAX = (
    0.001  # [m] allowed difference of the joint travel measured by the two tendons
)


class JointResult(NamedTuple):
    """Calibration result of one joint."""

    joint: int  # counted from 0
    directions: tuple[TendonCalibration, ...]  # one a tendon
    tendons: tuple[TendonConfig, ...]
    range: float  # [m] of travel between its stops; with one tendon, from its rest to its stop


def analyse_procedure(
    record: ProcedureData, config: InitialiseConfig, ranges: Sequence[float | None] = ()
) -> tuple[JointResult, ...]:
    """Evaluate the record of a procedure; return one result per calibrated joint.

    Parameters
    ----------
    record : ProcedureData
        From `slave.calibration.run.run_procedure`.
    config : InitialiseConfig
        Settings of the procedure.
    ranges : sequence of float or None
        Travel of each joint between its stops [m] in an earlier calibration.

    Raises
    ------
    CalibrationRefused
        If the measurement is not that of tendons in sheaths pulled against end stops.
    """
    before = [*ranges, *[None] * len(record.joints)]
    return tuple(
        _analyse_joint(record, config, j, before[j])
        for j in range(len(record.joints))
        if record.stops[j]
    )


def _analyse_joint(
    record: ProcedureData, config: InitialiseConfig, j: int, before: float | None
) -> JointResult:
    pulled = [PulledTendon(record, j, side) for side in range(len(record.joints[j]))]
    directions, tendons = evaluate_tendons(pulled, config)
    return JointResult(
        j, directions, tendons, _compute_joint_range(pulled, directions, config, before)
    )


def evaluate_tendons(
    pulled: Sequence[PulledTendon], config: InitialiseConfig
) -> tuple[tuple[TendonCalibration, ...], tuple[TendonConfig, ...]]:
    """Return the calibration and the estimator parameters of each tendon of a joint.

    Raises
    ------
    CalibrationRefused
        If a measurement is not that of a tendon in a sheath pulled against an end stop.
    """
    known = [get_known_sheath(config, p.tendon) for p in pulled]
    found = [calibrate_tendon(p, k, config.low) for p, k in zip(pulled, known, strict=True)]
    remark = ""
    if len(pulled) > 1:
        found, remark = combine_with_drags(pulled, found, config.gain_error)
    both = [
        build_tendon_calibration(p, k, f, remark)
        for p, k, f in zip(pulled, known, found, strict=True)
    ]
    return tuple(d for d, _ in both), tuple(t for _, t in both)


def _compute_joint_range(
    pulled: Sequence[PulledTendon],
    directions: tuple[TendonCalibration, ...],
    config: InitialiseConfig,
    before: float | None,
) -> float:
    """Return the travel of a joint between its stops [m], or from its rest with one tendon.

    Each of two tendons was pulled to its own stop and drawn out to the other's at a small tension,
    so each measures the whole range.
    """
    name = f"joint {pulled[0].joint + 1}"
    if len(pulled) == 1:
        seen = [directions[0].stop - float(pulled[0].travel[pulled[0].rows(Phase.SEEK)][0])]
    else:
        seen = [
            direction.stop - _compute_drawn_out_travel(own, other, direction)
            for own, other, direction in zip(pulled, pulled[::-1], directions, strict=True)
        ]
    found = sum(seen) / len(seen)
    if found < RANGE_MIN:
        raise CalibrationRefused(
            f"{name}: it moved only {max(found, 0.0) * 1e3:.1f} mm: it is jammed or its friction "
            "is too high; free it, or raise slave.initialise.tension"
        )
    if max(seen) - min(seen) > RANGE_DIFFERENCE_MAX + config.range_error * found:
        raise CalibrationRefused(
            f"{name}: tendon a measured {seen[0] * 1e3:.1f} mm of travel between the stops, "
            f"tendon b {seen[1] * 1e3:.1f} mm: a tendon slipped or is caught; check both"
        )
    expected = before if config.range is None else config.range
    if expected is not None and abs(found - expected) > config.range_error * expected:
        why = "by the earlier calibration" if config.range is None else "slave.initialise.range"
        raise CalibrationRefused(
            f"{name}: it travels {found * 1e3:.1f} mm between its stops, expected "
            f"{expected * 1e3:.1f} mm ({why}): the tip touches something or a stop has moved; "
            "free the tip, or set slave.initialise.range"
        )
    return round_significant(found)


def _compute_drawn_out_travel(
    own: PulledTendon, other: PulledTendon, direction: TendonCalibration
) -> float:
    """Return the travel [m] of the unstretched tendon with the joint at the other tendon's stop."""
    rows = np.flatnonzero(other.rows(Phase.SEEK))[-5:]
    return float(np.median(own.travel[rows] - direction.M_rel.value * own.tension[rows]))
