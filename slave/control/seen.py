"""The tendons of a sample as Python tuples, until fault detection and the loop take records."""

from collections.abc import Sequence
from math import nan
from typing import NamedTuple

from estimator.online.online import Status, TendonEstimate
from slave.rig import RigSample

_INVALID = int(Status.INVALID_INPUT)


class TendonSeen(NamedTuple):
    """One tendon, measured and estimated."""

    tension: float  # [N] measured at the housing
    displacement: float  # [m] measured motor position; NaN without an encoder
    elongation: float  # [m] estimated
    valid: bool  # whether the estimator took the sample
    estimate: TendonEstimate


def seen(sample: RigSample, estimates: Sequence[TendonEstimate]) -> tuple[TendonSeen, ...]:
    """Return the tendons of a sample with their estimates."""
    tension = sample.proximal_tension.tolist()
    travel = sample.proximal_displacement
    displacement = [nan] * len(tension) if travel is None else travel.tolist()
    return tuple(
        TendonSeen(T, q, estimate.elongation, not int(estimate.status) & _INVALID, estimate)
        for T, q, estimate in zip(tension, displacement, estimates, strict=True)
    )
