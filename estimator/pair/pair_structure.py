"""What a model of a pair leaves of the angle, and what that depends on."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.pair.pair import PairRecord
from estimator.pair.pair_fit import number_strokes

REST_SPEED_RATIO = 0.1  # of the angle's greatest speed: below, it rests
FAR_COMMAND_RATIO = 1.0 / 3.0  # of the command's peak: beyond, it counts as far out


class ResidualPart(NamedTuple):
    """What is left in some of the samples (predicted less measured), as shares of the span."""

    what: str
    mean: float
    rms: float


def compute_offset_share(records: Sequence[PairRecord], predicted: Sequence[Array]) -> float:
    """Return which share of the mean square is a constant of each record."""
    residuals = [(p - r.angle) / r.span for p, r in zip(predicted, records, strict=True)]
    total = sum(float(np.mean(residual**2)) for residual in residuals)
    return (
        sum(float(np.mean(residual)) ** 2 for residual in residuals) / total if total > 0.0 else 0.0
    )


def analyse_residuals(
    records: Sequence[PairRecord], predicted: Sequence[Array]
) -> tuple[ResidualPart, ...]:
    """Return what is left by direction, motion, command and time, each record's mean taken off."""
    residuals, groups = [], []
    for record, angle in zip(records, predicted, strict=True):
        residual = (angle - record.angle) / record.span
        residuals.append(residual - residual.mean())
        groups.append(_group_samples(record))
    all_residuals = np.concatenate(residuals)
    parts = []
    for name in groups[0]:
        residual = all_residuals[np.concatenate([group[name] for group in groups])]
        if residual.size:
            parts.append(
                ResidualPart(name, float(residual.mean()), float(np.sqrt(np.mean(residual**2))))
            )
    return tuple(parts)


def _group_samples(record: PairRecord) -> dict[str, NDArray[np.bool_]]:
    rising = np.gradient(record.command, record.time) > 0.0
    speed = np.abs(np.gradient(record.angle, record.time))
    is_resting = speed < REST_SPEED_RATIO * speed.max()
    share = record.command / np.abs(record.command).max()
    is_first = number_strokes(record.command) == 0
    return {
        "command rises": rising,
        "command falls": ~rising,
        "joint moves up": rising & ~is_resting,
        "joint moves down": ~rising & ~is_resting,
        "joint rests": is_resting,
        "command is far out, positive": share > FAR_COMMAND_RATIO,
        "command is near zero": np.abs(share) <= FAR_COMMAND_RATIO,
        "command is far out, negative": share < -FAR_COMMAND_RATIO,
        "stroke is the first": is_first,
        "stroke is a later one": ~is_first,
    }
