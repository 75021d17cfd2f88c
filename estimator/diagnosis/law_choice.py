"""Which base law a transmission has, by the likelihood of samples that were not fitted."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator.diagnosis.baseline import fit_baseline
from estimator.diagnosis.dataset import (
    Dataset,
    Fit,
    Model,
    build_unsimulated_contexts,
    compute_cost,
    replace_base,
)
from estimator.diagnosis.fit import fit_model, guess_record_parameters
from estimator.diagnosis.model import (
    PRETENSION,
    TIP_COMPLIANCE,
    TIP_MASS,
    BaseParameters,
    LoadModel,
)
from estimator.diagnosis.record import Record
from estimator.diagnosis.score import compute_errors, compute_log_likelihood_ratio
from estimator.diagnosis.settings import SETTINGS
from estimator.diagnosis.transmission_law import (
    EXCLUDED_EFFECTS,
    FRICTION,
    FRICTION_FORCE,
    PRESLIDING_WIDTH,
    BaseLaw,
)
from estimator.effects.effect import Effect

LAW_ROUNDS = 15  # of a fit that begins at another choice's
START_FRICTION_SHARE = 0.05  # K, and load-independent friction over the pretension, to begin with

LOOP_EFFECTS = frozenset(
    {
        "friction_step",
        "friction_drift",
        "viscous_friction",
        "stribeck_friction (by the motor's speed)",
        "nonuniform_curvature",
        "pretension (left by a pull)",
        "pretension (left by a release)",
        "joint_backlash",
        "tip_inertia",
        "tip_moved",
        "proximal_tension_gain",
        "distal_tension_gain",
        "proximal_tension_bias",
        "distal_tension_bias",
        "proximal_tension_drift",
        "distal_tension_drift",
        "sensor_lag",
        "encoder_scale",
        "encoder_slip",
        "pulley_eccentricity",
        "cogging_ripple",
    }
)
"""Effects, by name or label, that `lumped.loop_model` simulates or that are of a sensor."""


class ChoiceScore(NamedTuple):
    """A base law or a choice of loads, as it came out."""

    name: str
    score: float  # ln of how much more probable held-out data are than with the first, less BIC
    rmse: dict[str, float]  # held out, by channel, in the channel's unit


class Choice(NamedTuple):
    """A dataset with what was chosen, its fit, and the evidence."""

    dataset: Dataset
    fit: Fit
    scores: tuple[ChoiceScore, ...]  # of all that were tried; empty where nothing was to be chosen

    @property
    def alike(self) -> tuple[str, ...]:
        """Names of those that the data do not distinguish from the best."""
        best = max((one.score for one in self.scores), default=0.0)
        return tuple(one.name for one in self.scores if best - one.score < SETTINGS.alike)


def choose_law(dataset: Dataset, plain: Fit) -> Choice:
    """Return the base law that held-out samples speak for; `plain` is the fitted capstan law.

    Of a loop, the one of highest score; of those as good, the one of fewest parameters. A tendon
    stays with the capstan law and its effects, unless friction that no load changes is better alone
    and tension adds nothing to it.
    """
    alone = replace_base(dataset, BaseLaw.INDEPENDENT)
    tried = [(dataset, plain), (alone, fit_baseline(alone))]
    tried.append(_fit_combined_law(*tried))
    scores = _score_choices(tried, [one.base.law for one, _ in tried])
    capstan, independent, both = (one.score for one in scores)
    best = max(capstan, independent, both)
    if dataset.records[0].loop:
        chosen = next(i for i, one in enumerate(scores) if best - one.score < SETTINGS.alike)
    else:
        far = independent - capstan > SETTINGS.margin
        chosen = int(far and best - independent < SETTINGS.alike)
    return Choice(*tried[chosen], scores)


def choose_loads(dataset: Dataset, fit: Fit) -> Choice:
    """Return whether several files have a load at the tip each, or one together."""
    base = dataset.base
    if len(dataset.records) < 2 or TIP_COMPLIANCE not in base.shared:
        return Choice(dataset, fit, ())
    tried = [(dataset, fit)]
    for loads in (LoadModel.SPRINGS, LoadModel.MASSES):
        other = replace_base(dataset, base.law, loads)
        about = build_unsimulated_contexts(*tried[-1])
        start = _convert_load_model(tried[-1][0], tried[-1][1].model, other)
        tried.append((other, fit_model(other, about, start, LAW_ROUNDS)))
    scores = _score_choices(tried, [one.base.loads for one, _ in tried])
    shared, springs, masses = (one.score for one in scores)
    if max(springs, masses) - shared < SETTINGS.margin:
        return Choice(dataset, fit, scores)
    return Choice(*tried[2 if masses - springs > SETTINGS.margin else 1], scores)


def select_applicable_effects(
    effects: Sequence[Effect], record: Record, base: BaseParameters
) -> list[Effect]:
    """Return the effects that are defined for a record's channels and its base law."""
    left_out = EXCLUDED_EFFECTS[base.law] | ({"tip_inertia"} if TIP_MASS in base.own else set())
    return [
        effect
        for effect in effects
        if effect.needs <= set(record.signals)
        and effect.name not in left_out
        and (not record.loop or effect.name in LOOP_EFFECTS or effect.label in LOOP_EFFECTS)
    ]


def _score_choices(
    tried: Sequence[tuple[Dataset, Fit]], names: Sequence[str]
) -> tuple[ChoiceScore, ...]:
    found = [compute_errors(*one) for one in tried]
    size = [_count_parameters(one) for one, _ in tried]
    samples = sum(len(record.time) for record in tried[0][0].records)
    return tuple(
        ChoiceScore(
            str(name),
            compute_log_likelihood_ratio(one, found[0])
            - 0.5 * (p - size[0]) * float(np.log(samples)),
            {channel: of.rmse for channel, of in one.items()},
        )
        for name, one, p in zip(names, found, size, strict=True)
    )


def _count_parameters(dataset: Dataset) -> int:
    return len(dataset.base.shared) + len(dataset.base.own) * len(dataset.records)


def _fit_combined_law(
    capstan: tuple[Dataset, Fit], alone: tuple[Dataset, Fit]
) -> tuple[Dataset, Fit]:
    """Return the law of both, fitted from the fits of either with a little of the other."""
    both = replace_base(capstan[0], BaseLaw.BOTH)
    fits = []
    for dataset, fit in (capstan, alone):
        model = fit.model
        values = {FRICTION.name: START_FRICTION_SHARE, PRESLIDING_WIDTH.name: PRESLIDING_WIDTH.step}
        values |= dataset.base.values(model.shared, model.own[0])
        values.setdefault(
            FRICTION_FORCE.name, START_FRICTION_SHARE * max(values.get(PRETENSION.name, 0.0), 1.0)
        )
        start = model._replace(shared=tuple(values[p.name] for p in both.base.shared))
        fits.append(fit_model(both, build_unsimulated_contexts(dataset, fit), start, LAW_ROUNDS))
    return both, min(fits, key=lambda one: compute_cost(both, one))


def _convert_load_model(dataset: Dataset, model: Model, other: Dataset) -> Model:
    """Return a model with the parameters of another choice of loads, from its own values."""
    own = []
    for record, numbers in zip(dataset.records, model.own, strict=True):
        values = dataset.base.values(model.shared, numbers)
        begun = dict(
            zip(
                (p.name for p in other.base.own),
                guess_record_parameters(record, other.base, 0.0),
                strict=True,
            )
        )
        own.append(tuple(values.get(p.name, begun[p.name]) for p in other.base.own))
    values = dataset.base.values(model.shared, model.own[0])
    return model._replace(shared=tuple(values[p.name] for p in other.base.shared), own=tuple(own))
