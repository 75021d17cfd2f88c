"""Corrections of what the sensors at the housing read, one sample at a time.

The catalogue of effects (estimator.effects.sensors) says what a sensor makes of the true signals;
here that is taken away again. A correction has a kind, the values of its effect, and one number
that it remembers from the sample before.
"""

import math
from collections.abc import Sequence
from enum import IntEnum
from typing import Annotated

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.spline import evaluate_spline_at
from estimator.structs import I64, Field, Struct

MAX_CORRECTIONS = 8
"""Corrections that a tendon can have."""

MAX_VALUES = 14
"""Values that the effect of a correction can have."""

CURVE_ITERATIONS = 3  # by which a curve, of small slope, is inverted
READING_MAX = 1e6  # [m] that an encoder can read


class CorrectionKind(IntEnum):
    """What is taken away from T_in [N] or q_p [m]; `a`, `b`, `c` are the values of the effect."""

    TENSION_GAIN = 0  # T = reading / (1 + a)
    TENSION_BIAS = 1  # T = reading - a
    DISPLACEMENT_GAIN = 2  # q = reading / (1 + a)
    PULLEY_ECCENTRICITY = 3  # q = reading - a sin(reading/c) - b cos(reading/c)
    TENSION_RIPPLE = 4  # T = reading - a sin(c q) - b cos(c q)
    SHEATH_RUB = 5  # T = reading - a (q - p)/(b/2), p the play of q of width b
    TENSION_CURVE = 6  # T = reading - f(T), f a spline from a to b
    DISPLACEMENT_CURVE = 7  # q = reading - f(q), the same


class Correction(Struct):
    """One correction of a reading."""

    kind: I64 = 0  # CorrectionKind
    values: Annotated[Array, Field("f8", MAX_VALUES)]


class Corrections(Struct):
    """The corrections of one tendon, in the order in which they are made."""

    count: I64 = 0
    items: Annotated[Sequence[Correction], Field(Correction, MAX_CORRECTIONS)]


def build_corrections(readings: Sequence[tuple[CorrectionKind, Sequence[float]]]) -> Corrections:
    """Return the record of at most MAX_CORRECTIONS kinds with the values of their effects."""
    corrections = Corrections.new(count=len(readings))
    for item, (kind, values) in zip(corrections.items[: len(readings)], readings, strict=True):
        item.kind = int(kind)
        item.values[: len(values)] = values
    return corrections


@jit_compile
def _invert_curve(values: Array, reading: float) -> float:
    """Return the signal whose sum with a spline of it is a reading."""
    signal = reading
    for _ in range(CURVE_ITERATIONS):
        share = (signal - values[0]) / (values[1] - values[0])
        signal = reading - evaluate_spline_at(values[2:], share)
    return signal


@jit_compile
def correct_reading(
    corrections: Corrections, remembered: Array, T: float, q: float
) -> tuple[float, float]:
    """Return the true tension [N] and travel [m] of a reading; `remembered` is changed in place.

    `remembered` has shape (MAX_CORRECTIONS,), NaN before the first sample. No tendon pushes: a
    tension is not corrected to less than nothing. What cannot be a reading is returned as it is.
    """
    if corrections.count == 0 or not math.isfinite(T) or abs(q) > READING_MAX:
        return T, q
    tension_min = min(T, 0.0)
    for i in range(corrections.count):
        correction = corrections.items[i]
        kind, values = correction.kind, correction.values
        if kind == CorrectionKind.TENSION_GAIN:
            T = T / (1.0 + values[0])
        elif kind == CorrectionKind.TENSION_BIAS:
            T = T - values[0]
        elif kind == CorrectionKind.DISPLACEMENT_GAIN:
            q = q / (1.0 + values[0])
        elif kind == CorrectionKind.TENSION_CURVE:
            T = _invert_curve(values[:], T)
        elif math.isnan(q):
            continue  # the others follow the travel
        elif kind == CorrectionKind.DISPLACEMENT_CURVE:
            q = _invert_curve(values[:], q)
        elif kind == CorrectionKind.PULLEY_ECCENTRICITY:
            phase = q / values[2]
            q = q - values[0] * math.sin(phase) - values[1] * math.cos(phase)
        elif kind == CorrectionKind.TENSION_RIPPLE:
            phase = values[2] * q
            T = T - values[0] * math.sin(phase) - values[1] * math.cos(phase)
        elif kind == CorrectionKind.SHEATH_RUB:
            half, previous = 0.5 * values[1], remembered[i]
            remembered[i] = q if math.isnan(previous) else min(max(previous, q - half), q + half)
            T = T - values[0] * (q - remembered[i]) / half
    return max(T, tension_min), q
