"""The fit of the plain law: multi-start, to avoid local minima."""

import math

import numpy as np

from estimator.diagnosis.dataset import Dataset, Fit, Model, cost, simulated, thin
from estimator.diagnosis.fit import improved, own_start
from estimator.diagnosis.model import scene_of
from estimator.diagnosis.record import Record
from estimator.effects.effect import (
    DISTAL_DISPLACEMENT,
    PROXIMAL_DISPLACEMENT,
    PROXIMAL_TENSION,
    EffectContext,
)

FRICTIONS = (0.2, 0.45, 0.8, 1.2, 1.8)
TIP_SHARES = (0.0, 0.35, 0.75)
"""Of the travel per tension, that the tip may have where nothing at the tip was measured."""
TRIED = 5  # of the starts
FIRST_LOOK = 1500  # samples of a record
ROUNDS = 15


def baseline(dataset: Dataset) -> Fit:
    """Return the best fit of the plain law: from many starts on few samples, then on all."""
    few = thin(dataset, FIRST_LOOK)
    about = _contexts(few)
    starts = _starts(few)
    costs = [cost(few, simulated(few, about, model)) for model in starts]
    order = np.argsort(costs)[:TRIED]
    fits = [improved(few, about, starts[k], ROUNDS) for k in order]
    return again(dataset, min(fits, key=lambda fit: cost(few, fit)))


def again(dataset: Dataset, fit: Fit) -> Fit:
    """Return the fit of the plain law on from that of the same records, weighed otherwise."""
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
    first = dataset.records[0]
    if first.driver == PROXIMAL_TENSION:
        return [Model((K,), ((),) * len(dataset.records), ()) for K in FRICTIONS]
    starts = []
    for K in FRICTIONS:
        for share in _tip_shares(first):
            total = _travel_per_tension(first)
            tip = share * total * math.exp(K)
            plain = -math.expm1(-K) / K
            compliance = max((1.0 - share) * total / plain, 1e-6)
            own = tuple(own_start(record, compliance) for record in dataset.records)
            starts.append(Model((K, compliance, tip), own, ()))
    return starts


def _travel_per_tension(record: Record) -> float:
    """Return how far the motor goes for a newton while it pulls [m/N]."""
    T = record.signals[PROXIMAL_TENSION]
    taut = 0.1 * float(T.max()) < T
    q = record.signals[PROXIMAL_DISPLACEMENT]
    pulling = taut & (record.speed > 0.1 * float(np.abs(record.speed).max()))
    rows = pulling if pulling.sum() > 10 else taut
    # a line through pulls of which each begins anywhere: steeper than the tendon, never softer
    slope = float(np.polyfit(T[rows], q[rows], 1)[0])
    return min(max(slope, 1e-6), 1e-2)


def _tip_shares(record: Record) -> tuple[float, ...]:
    if DISTAL_DISPLACEMENT not in record.signals:
        return TIP_SHARES
    tip = float(np.ptp(record.signals[DISTAL_DISPLACEMENT]))
    motor = float(np.ptp(record.signals[PROXIMAL_DISPLACEMENT]))
    return (min(max(tip / motor, 0.0), 0.95),)
