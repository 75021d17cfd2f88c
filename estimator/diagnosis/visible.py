"""How small an effect could have been and still been seen, on a bench that has none."""

import math
from collections.abc import Sequence

import numpy as np

from estimator.diagnosis.fit import Bench, Fit, residual, scenes, simulated, slopes_of
from estimator.diagnosis.outcome import Visible
from estimator.effects.effect import Effect

SEEN = 60.0  # squares of the noise in all, beside what the model's own parameters take up
LARGEST = 50.0  # times a start: what is larger is not seen at all


def visible(bench: Bench, fit: Fit, effects: Sequence[Effect]) -> dict[str, Visible]:
    """Return for each effect the size at which it would have been seen; none where it could not.

    By a linear step from its starts: the residual that the model's own parameters do not take up
    grows with the size.
    """
    about = scenes(bench, fit)
    r = residual(bench, fit)
    basis, _ = np.linalg.qr(slopes_of(bench, about, fit))
    found: dict[str, Visible] = {}
    for effect in effects:
        first = effect.parameters[0]
        if first.neutral is None:
            continue
        for values in effect.starts(about[0]):
            model = fit.model._replace(effects=(*fit.model.effects, (effect, values)))
            change = residual(bench, simulated(bench, about, model)) - r
            change -= basis @ (basis.T @ change)
            power = float(change @ change)
            if not math.isfinite(power) or power < SEEN / LARGEST**2:
                continue
            size = abs(values[0] - first.neutral) * math.sqrt(SEEN / power)
            known = found.get(effect.name)
            if known is None or size < known.size:
                found[effect.name] = Visible(first.name, size, first.unit)
    return found
