"""The free function of an extended model: its curve with a band, and what it says in words."""

import math
from collections.abc import Sequence

import numpy as np

from estimator.diagnosis.dataset import Dataset, Fit, compute_residual
from estimator.diagnosis.fit import ParameterLayout, compute_jacobian
from estimator.diagnosis.intervals import estimate_residual_variance
from estimator.diagnosis.outcome import Curve
from estimator.effects.effect import EffectContext
from estimator.effects.functions import compute_basis, evaluate_function, split_values
from estimator.fitting import COVERAGE_FACTOR, compute_correlation_time
from estimator.units import Units, format_quantity

CURVE_POINTS = 101


def estimate_curve(dataset: Dataset, contexts: Sequence[EffectContext], fit: Fit) -> Curve | None:
    """Return the free function of a model with its 95 % interval; None without one.

    The band is that of the penalised fit (Wahba, J. R. Stat. Soc. B 45, 1983), of as many
    independent samples as the longest memory of a channel's residual leaves.
    """
    names = ParameterLayout(dataset, fit.model).names
    for effect, values in fit.model.effects:
        if (term := effect.function) is None:
            continue
        shapes, coefficients = split_values(effect, values)
        ends = (0.0, shapes[0]) if term.is_periodic else shapes
        x = np.linspace(ends[0], ends[1], CURVE_POINTS)
        first = names.index(f"{effect.name}.{effect.parameters[len(shapes)].name}")
        J = compute_jacobian(dataset, contexts, fit)
        residual = compute_residual(dataset, fit)
        variance = max(
            estimate_residual_variance(residual, J.shape[1]),
            _estimate_memory(dataset, fit) * float(np.mean(residual**2)),
        )
        columns = slice(first, first + len(coefficients))
        spread = np.linalg.pinv(J)[columns] * effect.parameters[-1].step
        basis = compute_basis(effect, values, x)
        centred = basis - basis.mean(axis=0)
        value = evaluate_function(effect, values, x)
        median = float(np.median(value))
        scale = 1.0 + median if term.is_share else 1.0
        half_width = COVERAGE_FACTOR * np.linalg.norm(centred @ spread, axis=1)
        return Curve(
            effect,
            x,
            (value - median) / scale,
            half_width * math.sqrt(variance) / scale,
            effect.parameters[-1].unit,
            shapes[0] if term.is_periodic else 0.0,
        )
    return None


def _estimate_memory(dataset: Dataset, fit: Fit) -> float:
    """Return over how many samples the residual of a channel remembers, at most."""
    return max(
        compute_correlation_time(
            ((simulated.signals[channel] - record.signals[channel]) / scale[channel])[
                record.train & record.valid[channel]
            ]
        )
        for record, simulated, scale in zip(
            dataset.records, fit.simulated, dataset.scale, strict=True
        )
        for channel in record.compared
    )


def describe_curve(curve: Curve, units: Units) -> str:
    """Return where a curve is farthest from its median, by how much, and how surely."""
    term, x, value = curve.effect.function, curve.x, curve.value
    if term is None:
        return ""
    sure = np.abs(value) - curve.half_width
    k = int(np.argmax(sure))
    is_beyond = value * math.copysign(1.0, value[k]) >= 0.5 * abs(value[k])
    below, above = np.flatnonzero(~is_beyond[:k]), np.flatnonzero(~is_beyond[k:])
    first = int(below[-1]) + 1 if len(below) else 0
    last = k + int(above[0]) - 1 if len(above) else len(x) - 1
    word = "more" if value[k] > 0.0 else "less"
    ends = [abs(value[k]) + sign * curve.half_width[k] for sign in (0, -1, 1)]
    unit = units.name_unit(curve.unit)
    size, low, high = (
        f"{end:.0%}" if term.is_share else format_quantity(end, unit, 2) for end in ends
    )
    begin, end = (
        format_quantity(float(x[i]), units.name_unit(term.unit), 3) for i in (first, last)
    )
    place = f"between {begin} and {end}"
    if curve.period:
        place += f" of a period of {format_quantity(curve.period, 's', 4)}"
    return (
        f"{term.target} depends on {term.variable}: {size} {word} than elsewhere {place} "
        f"({low} to {high})"
    )
