"""Which base law a transmission has, by the likelihood of samples that were not fitted."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator.diagnosis.baseline import baseline
from estimator.diagnosis.dataset import Dataset, Fit, Model, contexts_without, cost, with_base
from estimator.diagnosis.fit import improved, own_start
from estimator.diagnosis.model import MASS, PRETENSION, TIP, Base, Loads
from estimator.diagnosis.record import Record
from estimator.diagnosis.score import errors, log_likelihood_ratio
from estimator.diagnosis.settings import SETTINGS
from estimator.diagnosis.transmission_law import CONTAINED, FORCE, FRICTION, WIDTH, Law
from estimator.effects.effect import Effect

ROUNDS = 15  # of a fit that begins at another choice's
LITTLE = 0.05  # K, and load-independent friction over the pretension, to begin with

ON_LOOPS = frozenset(
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


class Scored(NamedTuple):
    """A base law or a choice of loads, as it came out."""

    name: str
    score: float  # ln of how much more probable held-out data are than with the first, less BIC
    rmse: dict[str, float]  # held out, by channel, in the channel's unit


class Choice(NamedTuple):
    """A dataset with what was chosen, its fit, and the evidence."""

    dataset: Dataset
    fit: Fit
    scores: tuple[Scored, ...]  # of all that were tried; empty where nothing was to be chosen

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
    alone = with_base(dataset, Law.INDEPENDENT)
    tried = [(dataset, plain), (alone, baseline(alone))]
    tried.append(_both(*tried))
    scores = _scored(tried, [one.base.law for one, _ in tried])
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
    if len(dataset.records) < 2 or TIP not in base.shared:
        return Choice(dataset, fit, ())
    tried = [(dataset, fit)]
    for loads in (Loads.SPRINGS, Loads.MASSES):
        other = with_base(dataset, base.law, loads)
        about = contexts_without(*tried[-1])
        start = _with_loads(tried[-1][0], tried[-1][1].model, other)
        tried.append((other, improved(other, about, start, ROUNDS)))
    scores = _scored(tried, [one.base.loads for one, _ in tried])
    shared, springs, masses = (one.score for one in scores)
    if max(springs, masses) - shared < SETTINGS.margin:
        return Choice(dataset, fit, scores)
    return Choice(*tried[2 if masses - springs > SETTINGS.margin else 1], scores)


def applicable(effects: Sequence[Effect], record: Record, base: Base) -> list[Effect]:
    """Return the effects that are defined for a record's channels and its base law."""
    left_out = CONTAINED[base.law] | ({"tip_inertia"} if MASS in base.own else set())
    return [
        effect
        for effect in effects
        if effect.needs <= set(record.signals)
        and effect.name not in left_out
        and (not record.loop or effect.name in ON_LOOPS or effect.label in ON_LOOPS)
    ]


def _scored(tried: Sequence[tuple[Dataset, Fit]], names: Sequence[str]) -> tuple[Scored, ...]:
    found = [errors(*one) for one in tried]
    size = [_parameters(one) for one, _ in tried]
    samples = sum(len(record.time) for record in tried[0][0].records)
    return tuple(
        Scored(
            str(name),
            log_likelihood_ratio(one, found[0]) - 0.5 * (p - size[0]) * float(np.log(samples)),
            {channel: of.rmse for channel, of in one.items()},
        )
        for name, one, p in zip(names, found, size, strict=True)
    )


def _parameters(dataset: Dataset) -> int:
    return len(dataset.base.shared) + len(dataset.base.own) * len(dataset.records)


def _both(capstan: tuple[Dataset, Fit], alone: tuple[Dataset, Fit]) -> tuple[Dataset, Fit]:
    """Return the law of both, fitted from the fits of either with a little of the other."""
    both = with_base(capstan[0], Law.BOTH)
    fits = []
    for dataset, fit in (capstan, alone):
        model = fit.model
        values = {FRICTION.name: LITTLE, WIDTH.name: WIDTH.step}
        values |= dataset.base.values(model.shared, model.own[0])
        values.setdefault(FORCE.name, LITTLE * max(values.get(PRETENSION.name, 0.0), 1.0))
        start = model._replace(shared=tuple(values[p.name] for p in both.base.shared))
        fits.append(improved(both, contexts_without(dataset, fit), start, ROUNDS))
    return both, min(fits, key=lambda one: cost(both, one))


def _with_loads(dataset: Dataset, model: Model, other: Dataset) -> Model:
    """Return a model with the parameters of another choice of loads, from its own values."""
    own = []
    for record, numbers in zip(dataset.records, model.own, strict=True):
        values = dataset.base.values(model.shared, numbers)
        begun = dict(
            zip((p.name for p in other.base.own), own_start(record, other.base, 0.0), strict=True)
        )
        own.append(tuple(values.get(p.name, begun[p.name]) for p in other.base.own))
    values = dataset.base.values(model.shared, model.own[0])
    return model._replace(shared=tuple(values[p.name] for p in other.base.shared), own=tuple(own))
