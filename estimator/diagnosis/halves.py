"""Which samples of a record are fitted, and which are held out: blocks in turn."""

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.diagnosis.settings import SETTINGS

Mask = NDArray[np.bool_]


def select_training_half(block: NDArray[np.int64], drive: Array, speed: Array) -> Mask:
    """Return which samples are fitted: every other block, if both halves see the same motion.

    A motion that repeats itself may be in one half while it pulls and in the other while it lets
    go. Then it is the blocks whose number has an even count of ones, a sequence (of Thue and Morse)
    that repeats nothing.
    """
    alternate: Mask = block % 2 == 0
    if _compute_imbalance(alternate, drive, speed) < SETTINGS.imbalance_max:
        return alternate
    odd = np.zeros_like(block)
    while block.any():
        odd, block = odd ^ (block & 1), block >> 1
    aperiodic = np.asarray(odd == 0)
    return min((alternate, aperiodic), key=lambda one: _compute_imbalance(one, drive, speed))


def _compute_imbalance(fitted: Mask, drive: Array, speed: Array) -> float:
    """Return how differently two halves are moved: 0 if the same, 1 if nothing is in both.

    It is the distance in total variation between what they have of low, middle and high drive,
    each while it rises, rests and falls.
    """
    level = np.searchsorted(np.quantile(drive, [1.0 / 3.0, 2.0 / 3.0]), drive)
    rest = SETTINGS.rest * float(np.quantile(np.abs(speed), 0.95))
    way = np.sign(speed) * (np.abs(speed) > rest)
    state = (3 * level + way + 1.0).astype(np.int64)
    shares = [
        np.bincount(state[half], minlength=9) / max(int(half.sum()), 1)
        for half in (fitted, ~fitted)
    ]
    return 0.5 * float(np.abs(shares[0] - shares[1]).sum())


def assign_blocks(time: Array, share: float = 1.0) -> NDArray[np.int64]:
    """Return the number of the block each sample is in, shape (n,); they are a `share` as long."""
    length = share * min(SETTINGS.block, float(time[-1] - time[0]) / SETTINGS.blocks_min)
    length = max(length, 2.0 * float(np.median(np.diff(time))))
    return np.asarray((time - time[0]) / length, dtype=np.int64)
