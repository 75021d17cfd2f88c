"""Signals with few lines in their spectrum, and what a system answered at those lines.

A multisine has odd harmonics of its period only, so that a system that is not linear answers at
harmonics that were not asked (Pintelon & Schoukens, "System Identification: A Frequency Domain
Approach", 2nd ed. 2012, chapters 3 and 4).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array

Lines = NDArray[np.complex128]


class Multisine(NamedTuple):
    """Sines of one period."""

    period: float  # [s]
    harmonics: tuple[int, ...]
    amplitude: tuple[float, ...]
    phase: tuple[float, ...]

    @property
    def frequency(self) -> Array:
        """Of each line [Hz]."""
        return np.array(self.harmonics) / self.period

    def at(self, time: float) -> float:
        """Return its value at a time [s]."""
        turns = 2.0 * np.pi * self.frequency * time + np.array(self.phase)
        return float(np.dot(self.amplitude, np.sin(turns)))


def draw(period: float, harmonics: tuple[int, ...], amplitude: Array, seed: int) -> Multisine:
    """Return a multisine with phases by `seed`."""
    phase = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, len(harmonics))
    return Multisine(period, harmonics, tuple(amplitude.tolist()), tuple(phase.tolist()))


def spectrum(values: Array, time: Array, frequency: Array) -> Lines:
    """Return the complex amplitude at each frequency [Hz]; whole periods, evenly sampled.

    `time` [s] is that of each value.
    """
    turns = np.exp(-2j * np.pi * np.outer(frequency, time))
    found: Lines = 2.0 / len(values) * turns @ values
    return found


def held(frequency: Array, dt: float) -> Lines:
    """Return what holding each sample for `dt` [s] does to a line: sinc and half a `dt` of lag."""
    found: Lines = np.sinc(frequency * dt) * np.exp(-1j * np.pi * frequency * dt)
    return found


class Response(NamedTuple):
    """Answer over input, a number a line, and its uncertainty."""

    value: Lines
    coherence: Array  # 1: all that was answered at this line was answered to this input
    distortion: float  # answer at lines not asked over answer at those asked, RMS


def response(excited: Lines, answer: Lines, others: Lines) -> Response:
    """Return the best linear approximation over several periods, shape (periods, lines).

    The coherence falls with noise, and with all that depends on the phases of the other lines.
    """
    cross = np.sum(answer * excited.conj(), axis=0)
    power, back = (np.sum(np.abs(x) ** 2, axis=0) for x in (excited, answer))
    coherence = np.abs(cross) ** 2 / np.maximum(power * back, np.finfo(float).tiny)
    distortion = float(np.sqrt(np.sum(np.abs(others) ** 2) / max(back.sum(), 1e-300)))
    return Response(cross / power, coherence, distortion)
