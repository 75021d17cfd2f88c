"""The fit of a base law: multi-start, to avoid local minima."""

import math

import numpy as np

from estimator.diagnosis.dataset import Dataset, Fit, Model, cost, simulated, thin
from estimator.diagnosis.fit import improved, own_start
from estimator.diagnosis.model import COMPLIANCE, PRETENSION, TIP, scene_of
from estimator.diagnosis.record import Record
from estimator.diagnosis.settings import SETTINGS
from estimator.diagnosis.transmission_law import FORCE, FRICTION, WIDTH, Law
from estimator.effects.effect import (
    DISTAL_DISPLACEMENT,
    PROXIMAL_DISPLACEMENT,
    PROXIMAL_TENSION,
    EffectContext,
)

FRICTIONS = (0.2, 0.45, 0.8, 1.2, 1.8)
TIP_SHARES = (0.0, 0.35, 0.75)
"""Of the travel per tension, that the tip may have where nothing at the tip was measured."""
FORCE_SHARES = (0.05, 0.15, 0.35)
"""Of the effort, that friction of any load may be."""
PRETENSION_SHARES = (0.3, 0.8, 2.0)
"""Of the largest effort, that the pretension of a loop may be."""
WIDTH_SHARES = (2e-3, 2e-2)
"""Of the motor's range, that contacts may give before they slide."""
TRIED = 5  # of the starts
FIRST_LOOK = 1500  # samples of a record
ROUNDS = 15


def baseline(dataset: Dataset) -> Fit:
    """Return the best fit of the base law: from many starts on few samples, then on all."""
    few = thin(dataset, FIRST_LOOK)
    about = _contexts(few)
    starts = _starts(few)
    costs = [cost(few, simulated(few, about, model)) for model in starts]
    order = np.argsort(costs)[:TRIED]
    fits = [improved(few, about, starts[k], ROUNDS) for k in order]
    return again(dataset, min(fits, key=lambda fit: cost(few, fit)))


def again(dataset: Dataset, fit: Fit) -> Fit:
    """Return the fit of the base law on from that of the same records, weighed otherwise."""
    return improved(dataset, _contexts(dataset), fit.model, ROUNDS)


def by_most(dataset: Dataset, fit: Fit) -> Fit:
    """Return the robust fit, started from the ordinary fit `fit`.

    Where something happened at one time, what came before it and what came after it are each fitted
    badly by one model; this one fits the longer part.
    """
    return improved(dataset, _contexts(dataset), fit.model, ROUNDS, robust=True)


def _contexts(dataset: Dataset) -> list[EffectContext]:
    return [scene_of(record, None, 1e-4) for record in dataset.records]


def _starts(dataset: Dataset) -> list[Model]:
    base, first = dataset.base, dataset.records[0]
    laws = loop_laws(first, base.law) if first.loop else tendon_laws(first, base.law)
    tips = _tip_shares(first) if TIP in (*base.shared, *base.own) else (0.0,)
    return [_start(dataset, law, share) for law in laws for share in tips]


def _start(dataset: Dataset, law: dict[str, float], share: float) -> Model:
    """Return a start with friction as `law` says and a share of the travel at the tip."""
    base, first = dataset.base, dataset.records[0]
    K = law.get(FRICTION.name, 0.0)
    total = _travel_per_tension(first)
    if first.loop:
        tip, compliance = share * total, 2.0 * (1.0 - share) * total
    elif COMPLIANCE in base.shared:
        plain = -math.expm1(-K) / K if K > 0.0 else 1.0
        tip, compliance = share * total * math.exp(K), (1.0 - share) * total / plain
    else:
        tip, compliance = total * math.exp(K), 0.0
    compliance = max(compliance, 1e-6)
    values = law | {COMPLIANCE.name: compliance, TIP.name: tip}
    own = tuple(own_start(record, base, compliance, tip) for record in dataset.records)
    return Model(tuple(values[p.name] for p in base.shared), own, ())


def tendon_laws(record: Record, law: Law) -> list[dict[str, float]]:
    """Return friction of a tendon to begin fits from, by name of the parameter."""
    if law is Law.CAPSTAN:
        return [{FRICTION.name: K} for K in FRICTIONS]
    T = record.signals[PROXIMAL_TENSION]
    forces = [share * float(np.quantile(T, 0.9)) for share in FORCE_SHARES]
    ways = [share * float(np.ptp(record.drive)) for share in WIDTH_SHARES]
    if record.driver == PROXIMAL_TENSION:
        ways = [share * SETTINGS.assumed_compliance * float(np.ptp(T)) for share in WIDTH_SHARES]
    return [
        {FRICTION.name: 0.2, FORCE.name: force, WIDTH.name: max(width, 2e-7)}
        for force in forces
        for width in ways
    ]


def loop_laws(record: Record, law: Law) -> list[dict[str, float]]:
    """Return friction and pretension of a loop to begin fits from, by name of the parameter.

    A loop whose cables rub with F each takes 2 F to turn, F about K times the pretension.
    """
    T = record.signals[PROXIMAL_TENSION]
    most = float(np.abs(T).max())
    widths = [share * float(np.ptp(record.drive)) for share in WIDTH_SHARES]
    starts = []
    for pretension in (share * most for share in PRETENSION_SHARES):
        for force in (share * most for share in FORCE_SHARES):
            K = min(max(force / pretension, 0.02), 3.0)
            begin = {PRETENSION.name: pretension, FRICTION.name: K, FORCE.name: force}
            if law is Law.BOTH:
                begin |= {FRICTION.name: 0.5 * K, FORCE.name: 0.5 * force}
            starts += [begin | {WIDTH.name: max(width, 2e-7)} for width in widths]
    return starts


def _travel_per_tension(record: Record) -> float:
    """Return how far the motor goes for a newton while it pulls, or the tip without it [m/N]."""
    T = record.signals[PROXIMAL_TENSION]
    q = record.signals.get(PROXIMAL_DISPLACEMENT, record.signals.get(DISTAL_DISPLACEMENT))
    if q is None:
        return 1e-6
    if record.loop:
        rows = np.abs(T) > 0.3 * float(np.abs(T).max())
        side = np.sign(T[rows])  # a line on each side: friction shifts it by the direction
        design = np.column_stack([T[rows], side, np.sign(record.speed[rows]), np.ones(rows.sum())])
        slope = float(np.linalg.lstsq(design, q[rows], rcond=None)[0][0])
        return min(max(slope, 1e-6), 1e-2)
    taut = 0.1 * float(T.max()) < T
    pulling = taut & (record.speed > 0.1 * float(np.abs(record.speed).max()))
    rows = pulling if pulling.sum() > 10 else taut
    # a line through pulls of which each begins anywhere: steeper than the tendon, never softer
    slope = float(np.polyfit(T[rows], q[rows], 1)[0])
    return min(max(slope, 1e-6), 1e-2)


def _tip_shares(record: Record) -> tuple[float, ...]:
    if DISTAL_DISPLACEMENT not in record.signals:
        return TIP_SHARES
    if record.driver == PROXIMAL_TENSION:
        return (1.0,)
    tip = float(np.ptp(record.signals[DISTAL_DISPLACEMENT]))
    motor = float(np.ptp(record.signals[PROXIMAL_DISPLACEMENT]))
    return (min(max(tip / motor, 0.0), 0.95),)
