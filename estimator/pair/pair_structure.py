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
    offs = [(p - r.angle) / r.span for p, r in zip(predicted, records, strict=True)]
    whole = sum(float(np.mean(off**2)) for off in offs)
    return sum(float(np.mean(off)) ** 2 for off in offs) / whole if whole > 0.0 else 0.0


def analyse_residuals(
    records: Sequence[PairRecord], predicted: Sequence[Array]
) -> tuple[ResidualPart, ...]:
    """Return what is left by direction, motion, command and time, each record's mean taken off."""
    left, groups = [], []
    for record, angle in zip(records, predicted, strict=True):
        off = (angle - record.angle) / record.span
        left.append(off - off.mean())
        groups.append(_group_samples(record))
    whole = np.concatenate(left)
    parts = []
    for name in groups[0]:
        off = whole[np.concatenate([group[name] for group in groups])]
        if off.size:
            parts.append(ResidualPart(name, float(off.mean()), float(np.sqrt(np.mean(off**2)))))
    return tuple(parts)


def _group_samples(record: PairRecord) -> dict[str, NDArray[np.bool_]]:
    rising = np.gradient(record.command, record.time) > 0.0
    speed = np.abs(np.gradient(record.angle, record.time))
    rests = speed < REST_SPEED_RATIO * speed.max()
    share = record.command / np.abs(record.command).max()
    first = number_strokes(record.command) == 0
    return {
        "command rises": rising,
        "command falls": ~rising,
        "joint moves up": rising & ~rests,
        "joint moves down": ~rising & ~rests,
        "joint rests": rests,
        "command is far out, positive": share > FAR_COMMAND_RATIO,
        "command is near zero": np.abs(share) <= FAR_COMMAND_RATIO,
        "command is far out, negative": share < -FAR_COMMAND_RATIO,
        "stroke is the first": first,
        "stroke is a later one": ~first,
    }
