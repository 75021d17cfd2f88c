"""From the record of an initialisation to what it says of each joint: pure functions.

Each tendon is calibrated by its own pulls and releases (`slave.calibration.direction`); both of a
joint are then put right by the drags (`slave.calibration.drags`).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from slave.calibration.config import InitialiseConfig, known_sheath
from slave.calibration.direction import calibrate_tendon, describe_direction, round_significant
from slave.calibration.drags import combine_with_drags
from slave.calibration.file import Direction
from slave.calibration.procedure_state import Phase
from slave.calibration.pulled import PulledTendon
from slave.calibration.run import CalibrationRefused, ProcedureData
from slave.tendon_config import TendonConfig

LEAST_RANGE = 0.001  # [m] of a joint that moves
RANGES_DIFFER = 0.001  # [m] by which the two tendons may see the joint travel unlike


class JointResult(NamedTuple):
    """What was found of one joint."""

    joint: int  # counted from 0
    directions: tuple[Direction, ...]  # one a tendon
    tendons: tuple[TendonConfig, ...]
    range: float  # [m] of travel between its stops; with one tendon, from its rest to its stop


def analyse(
    record: ProcedureData, config: InitialiseConfig, ranges: Sequence[float | None] = ()
) -> tuple[JointResult, ...]:
    """Return what a record says of each joint that went through the procedure.

    Parameters
    ----------
    record : ProcedureData
        From `slave.calibration.run.drive`.
    config : InitialiseConfig
        By which it was made.
    ranges : sequence of float or None
        How far each joint travelled between its stops [m] by an earlier calibration.

    Raises
    ------
    CalibrationRefused
        If what was measured cannot be tendons in their sheaths against end stops.
    """
    before = [*ranges, *[None] * len(record.joints)]
    return tuple(
        _joint(record, config, j, before[j]) for j in range(len(record.joints)) if record.stops[j]
    )


def _joint(
    record: ProcedureData, config: InitialiseConfig, j: int, before: float | None
) -> JointResult:
    pulled = [PulledTendon(record, j, side) for side in range(len(record.joints[j]))]
    directions, tendons = evaluate(pulled, config)
    return JointResult(j, directions, tendons, _range(pulled, directions, config, before))


def evaluate(
    pulled: Sequence[PulledTendon], config: InitialiseConfig
) -> tuple[tuple[Direction, ...], tuple[TendonConfig, ...]]:
    """Return what was found of all tendons of a joint, and what the estimators use.

    Raises
    ------
    CalibrationRefused
        If what was measured of one cannot be a tendon in its sheath against an end stop.
    """
    known = [known_sheath(config, p.tendon) for p in pulled]
    found = [calibrate_tendon(p, k, config.low) for p, k in zip(pulled, known, strict=True)]
    remark = ""
    if len(pulled) > 1:
        found, remark = combine_with_drags(pulled, found, config.gain_error)
    both = [
        describe_direction(p, k, f, remark) for p, k, f in zip(pulled, known, found, strict=True)
    ]
    return tuple(d for d, _ in both), tuple(t for _, t in both)


def _range(
    pulled: Sequence[PulledTendon],
    directions: tuple[Direction, ...],
    config: InitialiseConfig,
    before: float | None,
) -> float:
    """Return the travel of a joint between its stops [m], or from its rest with one tendon.

    Each of two tendons has been at its own stop, pulled, and at the other's, drawn out at a small
    tension; so each says how far the joint went.
    """
    name = f"joint {pulled[0].joint + 1}"
    if len(pulled) == 1:
        seen = [directions[0].stop - float(pulled[0].travel[pulled[0].rows(Phase.SEEK)][0])]
    else:
        seen = [
            direction.stop - _drawn_out(own, other, direction)
            for own, other, direction in zip(pulled, pulled[::-1], directions, strict=True)
        ]
    found = sum(seen) / len(seen)
    if found < LEAST_RANGE:
        raise CalibrationRefused(
            f"{name}: it moved {max(found, 0.0) * 1e3:.1f} mm only: it is jammed, or its friction "
            "takes all the tension; free it, or raise slave.initialise.tension"
        )
    if max(seen) - min(seen) > RANGES_DIFFER + config.range_error * found:
        raise CalibrationRefused(
            f"{name}: tendon a saw it travel {seen[0] * 1e3:.1f} mm between its stops, tendon b "
            f"{seen[1] * 1e3:.1f} mm: a tendon has slipped, or hangs on something"
        )
    expected = before if config.range is None else config.range
    if expected is not None and abs(found - expected) > config.range_error * expected:
        why = "by the earlier calibration" if config.range is None else "slave.initialise.range"
        raise CalibrationRefused(
            f"{name}: it travels {found * 1e3:.1f} mm between its stops, {expected * 1e3:.1f} mm "
            f"were expected ({why}): the tip touches something early, or a stop has moved; free "
            "it, or set slave.initialise.range"
        )
    return round_significant(found)


def _drawn_out(own: PulledTendon, other: PulledTendon, direction: Direction) -> float:
    """Return the travel [m] of the unstretched tendon with the joint at the other tendon's stop."""
    rows = np.flatnonzero(other.rows(Phase.SEEK))[-5:]
    return float(np.median(own.travel[rows] - direction.M_rel.value * own.tension[rows]))
