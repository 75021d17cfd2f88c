"""Piecewise-linear friction over time, the reference for causes in time.

A step or a drift is the nearest of the catalogue to friction that wanders, and takes most of it up.
It is not the cause if a course that is free to be anything does far better.
"""

import numpy as np

from estimator.array_types import Array
from estimator.diagnosis.dataset import (
    Dataset,
    Fit,
    build_contexts,
    rescale_residuals,
    use_all_samples,
)
from estimator.diagnosis.fit import fit_model
from estimator.diagnosis.score import compute_errors, compute_residual_fraction
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import Effect, EffectContext, Parameter, Values
from estimator.lumped.lumped_model import Physics

KNOTS = 20
FRICTION_TIME_EFFECTS = frozenset({"friction_step", "friction_drift"})
FRICTION_ROUNDS = 25


def _place_knots(context: EffectContext) -> Array:
    return np.linspace(context.time[0], context.time[-1], KNOTS)


def _apply_friction_course(physics: Physics, values: Values, context: EffectContext) -> Physics:
    share = 1.0 + np.interp(context.time, _place_knots(context), values)
    return physics._replace(friction=physics.friction * share)


FRICTION_COURSE = Effect(
    name="friction_course",
    cause="friction changes with time, neither at once nor steadily",
    equation="K(t) = K (1 + c(t)), c linear between its knots",
    parameters=tuple(Parameter(f"change_{k}", "", -0.9, 5.0, 0.05) for k in range(1, KNOTS + 1)),
    source="no law: what is free to follow the data",
    advice="Look for what comes and goes: a sheath that is moved, temperature, lubricant.",
    starts=lambda _: [(0.0,) * KNOTS],
    physics=_apply_friction_course,
)


def has_drifting_friction(dataset: Dataset, fit: Fit) -> bool:
    """Return whether friction takes another course over time than a model's causes say.

    Both are fitted to all samples: a course that is free has no say about a time that is held out.
    """
    in_time = [effect for effect, _ in fit.model.effects if effect.name in FRICTION_TIME_EFFECTS]
    if not in_time:
        return False
    full = use_all_samples(dataset)
    described = fit_model(
        rescale_residuals(full, fit), build_contexts(full, fit), fit.model, FRICTION_ROUNDS
    )
    return any(
        _is_far_better(full, fit_time_varying_friction(full, described, one), described)
        for one in in_time
    )


def _is_far_better(dataset: Dataset, free: Fit, described: Fit) -> bool:
    a, b = (compute_errors(dataset, one, held_out=False) for one in (free, described))
    return compute_residual_fraction(a, b) < SETTINGS.free_friction


def fit_time_varying_friction(dataset: Dataset, fit: Fit, effect: Effect) -> Fit:
    """Return a model in which friction takes any course instead of what `effect` says of it."""
    about = build_contexts(dataset, fit)
    rest: list[tuple[Effect, Values]] = []
    course: Values = (0.0,) * KNOTS
    for one, values in fit.model.effects:
        if one.name != effect.name:
            rest.append((one, values))
            continue
        plain = Physics(np.ones_like(about[0].time), 1.0, np.ones(1))
        change = one.physics(plain, values, about[0]).friction - 1.0
        course = tuple(np.interp(_place_knots(about[0]), about[0].time, change).tolist())
    model = fit.model._replace(effects=(*rest, (FRICTION_COURSE, course)))
    return fit_model(rescale_residuals(dataset, fit), about, model, FRICTION_ROUNDS)
