"""A second, independent maker of clean records: a grid of play operators driven by random strokes.

The tendon is cut into cells of equal bend angle. From cell to cell the tension may fall or rise by
the factor exp(K/n) at most (the capstan rule, Euler 1769), and stays what it was in between: a play
operator each. The tension at the housing is the one for which all cells together are as long as the
motor's travel asks, found by bisection. The truth runs at 1 kHz, whatever the rate of the record.

Nothing is shared with `chain` or `estimator`: no springs and beads, no graded nodes.
"""

from typing import NamedTuple

import numpy as np

from estimator.compiled import jit_compile

CELLS = 500
INNER = 1000  # [Hz] of the truth
CORNER = 0.2  # [s] over which the motor changes its speed
TOP = 20.0  # [N] of the longest strokes
NOISE = 0.02  # [N] white, of the load cells
RESOLUTION = 1e-7  # [m] of the encoders


class GridRecord(NamedTuple):
    """A record and its secret."""

    time: np.ndarray  # [s], shape (n,)
    channels: dict  # name -> readings [N], [m], shape (n,)
    K: float
    compliance: float  # L/EA [m/N]


@jit_compile
def _fill(T_in, before, ratio, after):
    """Fill in the tension of each cell for one at the housing; return their sum [N]."""
    T, total = T_in, 0.0
    for j in range(len(before)):
        T = min(max(before[j], T / ratio), T * ratio)
        after[j] = T
        total += T
    return total


@jit_compile
def pull_motor(travel, K, compliance, spring):
    """Return the tensions at housing and tip and the tip's travel under a motor's travel.

    `compliance` is L/EA [m/N] of the tendon, `spring` [m/N] that of what the tip pulls at.
    """
    ratio = np.exp(K / CELLS)
    cells, after = np.zeros(CELLS), np.zeros(CELLS)
    out = np.zeros((len(travel), 3))
    for i in range(len(travel)):
        low, high = 0.0, 1.0
        while (
            compliance / CELLS * _fill(high, cells, ratio, after) + spring * after[-1] < travel[i]
        ):
            high *= 2.0
        while high - low > 1e-9:
            middle = 0.5 * (low + high)
            total = compliance / CELLS * _fill(middle, cells, ratio, after) + spring * after[-1]
            if total < travel[i]:
                low = middle
            else:
                high = middle
        _fill(high if travel[i] > 0.0 else 0.0, cells, ratio, after)
        cells[:] = after
        out[i] = after[0], after[-1], spring * after[-1]
    return out


def draw_strokes(rng, full, duration):
    """Return a motor's travel [m] at the inner rate: strokes and rests at random, slack at first.

    Every record has a full pull and release, a long rest, and turns without any.
    """
    corners, heights, now = [0.0, 0.5], [0.0, 0.0], 0.5
    ends = [1.0, 0.02, 0.7, 0.7, *rng.uniform(0.0, 1.0, 400)]
    for k, end in enumerate(ends):
        speed = np.exp(rng.uniform(np.log(0.12), np.log(1.5)))
        way = abs(end - heights[-1] / full)
        now += max(way / speed, 0.1) if way else 3.0
        corners.append(now)
        heights.append(end * full)
        if k > 3 and rng.random() < 0.5:
            now += rng.exponential(0.7)
            corners.append(now)
            heights.append(end * full)
        if now > duration:
            break
    time = np.arange(round(duration * INNER)) / INNER
    window = np.hanning(round(CORNER * INNER) + 2)
    path = np.interp(time, corners, heights)
    padded = np.concatenate([np.zeros(len(window) - 1), path])
    return np.convolve(padded, window / window.sum(), mode="valid")[: len(time)]


def make_grid(seed, bench="blocked", duration=60.0, rate=100.0, travel_noise=0.0):
    """Return the clean record of a seed on a blocked or sprung tip.

    `travel_noise` [m] is white, on both travels. The rate divides 1 kHz.
    """
    rng = np.random.default_rng([seed, bench == "spring", 77])
    K, compliance = rng.uniform(0.4, 1.5), np.exp(rng.uniform(np.log(8e-5), np.log(3e-4)))
    spring = compliance * rng.uniform(0.5, 3.0) if bench == "spring" else 0.0
    full = TOP * (compliance * -np.expm1(-K) / K + spring * np.exp(-K))
    travel = draw_strokes(rng, full, duration)
    true = pull_motor(travel, K, compliance, spring)
    every = round(INNER / rate)
    rows = slice(None, None, every)

    def cell(tension):
        return tension + NOISE * rng.standard_normal(len(tension))

    def encoder(q):
        return RESOLUTION * np.round((q + travel_noise * rng.standard_normal(len(q))) / RESOLUTION)

    channels = {
        "proximal_tension": cell(true[rows, 0]),
        "proximal_displacement": encoder(travel[rows]),
        "distal_tension": cell(true[rows, 1]),
        "distal_displacement": encoder(true[rows, 2]),
    }
    return GridRecord(np.arange(len(true))[rows] / INNER, channels, K, compliance)
