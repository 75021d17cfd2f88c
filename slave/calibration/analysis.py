"""Evaluate the record of an initialisation, joint by joint: pure functions.

Each tendon is calibrated by its own pulls and releases (`tendon_identification`); the two of a
joint are then corrected with the drags.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from estimator.calibration.calibration import (
    AGREEMENT,
    Calibration,
    CalibrationError,
    MeasuredValue,
    combine_calibrations,
)
from estimator.calibration.drag import fit_friction_sum
from slave.calibration.calibration_file import TendonCalibration
from slave.calibration.config import InitialiseConfig, get_known_range, get_known_sheath
from slave.calibration.procedure_log import ProcedureData
from slave.calibration.procedure_run import CalibrationRefused
from slave.calibration.procedure_state import Phase
from slave.calibration.tendon_identification import (
    ArmStretches,
    PulledTendon,
    build_tendon_calibration,
    calibrate_tendon,
    round_significant,
)
from slave.tendon_config import TendonConfig

# --- combine the loops of a joint's two tendons with the drags, which measure K_a + K_b
# A loop with the tip blocked hardly depends on friction near the tip. In a drag one tendon draws
# the other out and both slide along their whole length: their K add up, wherever the friction is
# (docs/explanation/theory.md (T20)). A relative gain difference g of the load cells biases the sum
# by g, with opposite sign in the opposite drag, so the mean is unbiased.


def combine_with_drags(
    pulled: Sequence[PulledTendon],
    calibrations: Sequence[Calibration],
    gain_error: float,
    total: MeasuredValue | None = None,
) -> tuple[list[Calibration], str]:
    """Return the calibrations of two antagonists from loops and drags, and a remark.

    If drags and loops contradict each other, the loops are used and the remark says so.

    `pulled` are tendon a and b, `calibrations` from their loops, `gain_error` is the relative
    standard uncertainty of each load cell's gain, `total` K_a + K_b of the sheaths, where the
    tendons slide on guides besides (`guide_friction`).
    """
    a, b = calibrations
    try:
        total = total or _estimate_friction_sum(pulled, calibrations, gain_error)
        return list(combine_calibrations(a, b, total)), ""
    except CalibrationError as error:
        return [a, b], (
            f"drags not used, K is from the loops alone: {error}; the joint's own friction may "
            "grow with its load, or load cells or friction differ with direction"
        )


def _estimate_friction_sum(
    pulled: Sequence[PulledTendon], calibrations: Sequence[Calibration], gain_error: float
) -> MeasuredValue:
    """Return K_a + K_b from all drags."""
    sums = [
        _estimate_sum_from_drag(tendon, antagonist, calibration.M_pull.value)
        for tendon, antagonist, calibration in zip(
            pulled, reversed(pulled), calibrations, strict=True
        )
        if tendon.dragging.any()
    ]
    if not sums:
        raise CalibrationError("no drag was recorded")
    gains = math.sqrt(2.0) * gain_error
    if len(sums) == 1:
        return MeasuredValue(sums[0].value, math.hypot(sums[0].uncertainty, gains))
    first, second = sums
    noise = math.hypot(first.uncertainty, second.uncertainty)
    if abs(first.value - second.value) > AGREEMENT * math.hypot(noise, 2.0 * gains):
        raise CalibrationError(
            f"K of both tendons is {first.value:.3f} as a draws b, {second.value:.3f} as b draws a"
        )
    return MeasuredValue(0.5 * (first.value + second.value), 0.5 * noise)


def _estimate_sum_from_drag(
    tendon: PulledTendon, antagonist: PulledTendon, M_pull: float
) -> MeasuredValue:
    """Return K_a + K_b from one drag; `M_pull` [m/N] is of the pulled tendon."""
    rows = tendon.dragging
    if len(np.unique(tendon.record.stage[rows])) > 1:
        raise CalibrationError("guides of passed joints add to it, by an unknown friction")
    tension = tendon.tension[rows]
    travel = tendon.travel[rows] - M_pull * tension
    return fit_friction_sum(tension, antagonist.tension[rows], travel)


RANGE_MIN = 0.001  # [m] of a joint that moves
# [m] allowed difference of the joint travel measured by the two tendons
RANGE_DIFFERENCE_MAX = 0.001


NO_SUMS: Mapping[int, MeasuredValue] = {}
NO_ARM: Mapping[tuple[int, int], ArmStretches] = {}


class JointResult(NamedTuple):
    """Calibration result of one joint."""

    joint: int  # counted from 0
    directions: tuple[TendonCalibration, ...]  # one a tendon
    tendons: tuple[TendonConfig, ...]
    range: float  # [m] of travel between its stops; with one tendon, from its rest to its stop


def analyse_procedure(
    record: ProcedureData,
    config: InitialiseConfig,
    ranges: Sequence[float | None] = (),
    sums: Mapping[int, MeasuredValue] = NO_SUMS,
    in_arm: Mapping[tuple[int, int], ArmStretches] = NO_ARM,
) -> tuple[JointResult, ...]:
    """Evaluate the record of a procedure; return one result per calibrated joint.

    `ranges` [m] are the travel of each joint between its stops in an earlier calibration, `sums`
    K_a + K_b of the sheaths of joints whose tendons pass others, `in_arm` what follows the sheath
    of a joint's tendon. `CalibrationRefused` if the measurement is not that of tendons in sheaths
    pulled against end stops.
    """
    results, earlier_ranges = [], [*ranges, *[None] * len(record.joints)]
    for j, stops in enumerate(record.stops):
        if stops:
            pulled = [
                PulledTendon(record, j, side, in_arm.get((j, side)))
                for side in range(len(record.joints[j]))
            ]
            directions, tendons = evaluate_tendons(pulled, config, sums.get(j))
            travel = _compute_joint_range(pulled, directions, config, earlier_ranges[j])
            results.append(JointResult(j, directions, tendons, travel))
    return tuple(results)


def evaluate_tendons(
    pulled: Sequence[PulledTendon], config: InitialiseConfig, total: MeasuredValue | None = None
) -> tuple[tuple[TendonCalibration, ...], tuple[TendonConfig, ...]]:
    """Return the calibration and the estimator parameters of each tendon of a joint.

    `CalibrationRefused` if a measurement is not that of a tendon in a sheath pulled against an end
    stop.
    """
    sheaths = [get_known_sheath(config, p.tendon) for p in pulled]
    calibrations = [
        calibrate_tendon(p, k, config.low) for p, k in zip(pulled, sheaths, strict=True)
    ]
    remark = ""
    if len(pulled) > 1:
        calibrations, remark = combine_with_drags(pulled, calibrations, config.gain_error, total)
    entries = [
        build_tendon_calibration(p, k, f, remark)
        for p, k, f in zip(pulled, sheaths, calibrations, strict=True)
    ]
    return tuple(d for d, _ in entries), tuple(t for _, t in entries)


def _compute_joint_range(
    pulled: Sequence[PulledTendon],
    directions: tuple[TendonCalibration, ...],
    config: InitialiseConfig,
    earlier_range: float | None,
) -> float:
    """Return the travel of a joint between its stops [m], or from its rest with one tendon.

    Each of two tendons was pulled to its own stop and drawn out to the other's at a small tension,
    so each measures the whole range.
    """
    name = f"joint {pulled[0].joint + 1}"
    if len(pulled) == 1:
        ranges = [
            directions[0].stop - float(pulled[0].travel[pulled[0].select_rows(Phase.SEEK)][0])
        ]
    else:
        ranges = [
            direction.stop - _compute_drawn_out_travel(tendon, antagonist, direction)
            for tendon, antagonist, direction in zip(pulled, pulled[::-1], directions, strict=True)
        ]
    travel = sum(ranges) / len(ranges)
    if travel < RANGE_MIN:
        raise CalibrationRefused(
            f"{name}: it moved only {max(travel, 0.0) * 1e3:.1f} mm: it is jammed or its friction "
            "is too high; free it, or raise slave.initialise.tension"
        )
    if max(ranges) - min(ranges) > RANGE_DIFFERENCE_MAX + config.range_error * travel:
        raise CalibrationRefused(
            f"{name}: tendon a measured {ranges[0] * 1e3:.1f} mm of travel between the stops, "
            f"tendon b {ranges[1] * 1e3:.1f} mm: a tendon slipped or is caught; check both"
        )
    known_range = get_known_range(config, pulled[0].joint)
    expected = earlier_range if known_range is None else known_range
    if expected is not None and abs(travel - expected) > config.range_error * expected:
        source = "by the earlier calibration" if known_range is None else "slave.initialise.range"
        raise CalibrationRefused(
            f"{name}: it travels {travel * 1e3:.1f} mm between its stops, expected "
            f"{expected * 1e3:.1f} mm ({source}): the tip touches something or a stop has moved; "
            "free the tip, or set slave.initialise.range"
        )
    return round_significant(travel)


def _compute_drawn_out_travel(
    tendon: PulledTendon, antagonist: PulledTendon, direction: TendonCalibration
) -> float:
    """Return the travel [m] of the unstretched tendon with the joint at the other tendon's stop."""
    rows = np.flatnonzero(antagonist.select_rows(Phase.SEEK))[-5:]
    return float(np.median(tendon.travel[rows] - direction.M_rel.value * tendon.tension[rows]))
