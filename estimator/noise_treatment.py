"""What sensor noise does to a transmission that remembers peaks, and how it is kept out.

T_out is a peak-holding function of T_in, so zero-mean noise on T_in does not average out: every
upward excursion drives the profile and stays in it. Of N samples at one and the same tension the
largest stands some sqrt(2 ln N) sigma above it, 3.2 sigma for a second at 1 kHz
(docs/explanation/theory.md, section 9). The estimator therefore drives its profile with a treated
tension: a short average, which takes sigma down, then a dead band (a play operator of its own) that
what is left of the noise seldom crosses (estimator.online.online). studies/noise_treatment.py
measures what that costs and gains.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from estimator.array_types import Array
from estimator.compiled import jit_compile

_MAD_TO_SIGMA = 1.4826  # of a normal distribution
_SECOND_DIFFERENCE = math.sqrt(6.0)  # its sigma over that of white noise


@dataclass(frozen=True, slots=True)
class Treatment:
    """How a noisy tension is made fit to drive the profile."""

    time_constant: float = 0.002  # [s] of a first-order average, by which it lags; 0 for none
    dead_band: float = 2.0  # half-width of the play that follows, in sigma of the average; 0: none

    def __post_init__(self) -> None:
        """Refuse what cannot be computed."""
        if not 0.0 <= self.time_constant < 1.0:
            raise ValueError(f"time_constant: {self.time_constant} s, allowed are 0 to 1 s")
        if not 0.0 <= self.dead_band <= 10.0:
            raise ValueError(f"dead_band: {self.dead_band} sigma, allowed are 0 to 10")


def estimate_noise_sigma(signal: ArrayLike) -> float:
    """Return the standard deviation of the white noise on a slowly changing signal.

    From the median of |second differences|: steps, ramps and bursts of motion in less than half of
    the record do not disturb it, best is a record at rest. It reads low when samples are repeated
    or the noise is below the quantisation.

    Parameters
    ----------
    signal : array_like
        Shape (n,), n >= 8, evenly sampled.
    """
    values = np.asarray(signal, dtype=np.float64)
    if values.ndim != 1 or len(values) < 8 or not np.isfinite(values).all():
        raise ValueError("signal: at least 8 finite samples in one row are needed")
    return float(np.median(np.abs(np.diff(values, 2)))) * _MAD_TO_SIGMA / _SECOND_DIFFERENCE


@jit_compile
def update_average(previous: float, measured: float, dt: float, time_constant: float) -> float:
    """Return the next value of a first-order average, exact for any `dt` [s]."""
    if time_constant <= 0.0:
        return measured
    return measured + (previous - measured) * math.exp(-dt / time_constant)


@jit_compile
def update_variance(previous: float, sigma: float, dt: float, time_constant: float) -> float:
    """Return the variance of white noise after `update_average`, from the one before."""
    decay = math.exp(-dt / time_constant) if time_constant > 0.0 else 0.0
    return (decay * decay) * previous + ((1.0 - decay) * sigma) ** 2


@jit_compile
def update_play(previous: float, value: float, half_width: float) -> float:
    """Return the output of a play operator: it moves only when `value` is further off than that."""
    return min(max(previous, value - half_width), value + half_width)


@jit_compile
def apply_play(signal: Array, half_width: float) -> Array:
    """Return a signal after a play operator that begins in its middle, shape (n,)."""
    out = signal.copy()
    for i in range(1, len(signal)):
        out[i] = update_play(out[i - 1], signal[i], half_width)
    return out
