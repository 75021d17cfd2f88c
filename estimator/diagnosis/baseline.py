"""The fit of a base law: multi-start, to avoid local minima."""

import math

import numpy as np

from estimator.diagnosis.dataset import (
    Dataset,
    Fit,
    Model,
    compute_cost,
    simulate_dataset,
    subsample,
)
from estimator.diagnosis.fit import fit_model, guess_record_parameters
from estimator.diagnosis.model import COMPLIANCE, PRETENSION, TIP_COMPLIANCE, build_context
from estimator.diagnosis.record import Record
from estimator.diagnosis.settings import SETTINGS
from estimator.diagnosis.transmission_law import FRICTION, FRICTION_FORCE, PRESLIDING_WIDTH, BaseLaw
from estimator.effects.effect import (
    DISTAL_DISPLACEMENT,
    PROXIMAL_DISPLACEMENT,
    PROXIMAL_TENSION,
    EffectContext,
)

START_FRICTIONS = (0.2, 0.45, 0.8, 1.2, 1.8)
TIP_SHARES = (0.0, 0.35, 0.75)
"""Of the travel per tension, that the tip may have where nothing at the tip was measured."""
FORCE_SHARES = (0.05, 0.15, 0.35)
"""Of the effort, that friction of any load may be."""
PRETENSION_SHARES = (0.3, 0.8, 2.0)
"""Of the largest effort, that the pretension of a loop may be."""
WIDTH_SHARES = (2e-3, 2e-2)
"""Of the motor's range, that contacts may give before they slide."""
STARTS_KEPT = 5  # of the starts
SUBSAMPLE_SIZE = 1500  # samples of a record
ROUNDS = 15


def fit_baseline(dataset: Dataset) -> Fit:
    """Return the best fit of the base law: from many starts on few samples, then on all."""
    few = subsample(dataset, SUBSAMPLE_SIZE)
    about = _build_initial_contexts(few)
    starts = _build_starts(few)
    costs = [compute_cost(few, simulate_dataset(few, about, model)) for model in starts]
    order = np.argsort(costs)[:STARTS_KEPT]
    fits = [fit_model(few, about, starts[k], ROUNDS) for k in order]
    return refit_baseline(dataset, min(fits, key=lambda fit: compute_cost(few, fit)))


def refit_baseline(dataset: Dataset, fit: Fit) -> Fit:
    """Return the fit of the base law on from that of the same records, weighed otherwise."""
    return fit_model(dataset, _build_initial_contexts(dataset), fit.model, ROUNDS)


def fit_robustly(dataset: Dataset, fit: Fit) -> Fit:
    """Return the robust fit, started from the ordinary fit `fit`.

    Where something happened at one time, what came before it and what came after it are each fitted
    badly by one model; this one fits the longer part.
    """
    return fit_model(dataset, _build_initial_contexts(dataset), fit.model, ROUNDS, robust=True)


def _build_initial_contexts(dataset: Dataset) -> list[EffectContext]:
    return [build_context(record, None, 1e-4) for record in dataset.records]


def _build_starts(dataset: Dataset) -> list[Model]:
    base, first = dataset.base, dataset.records[0]
    laws = (
        build_loop_starts(first, base.law) if first.loop else build_tendon_starts(first, base.law)
    )
    tips = _estimate_tip_shares(first) if TIP_COMPLIANCE in (*base.shared, *base.own) else (0.0,)
    return [_build_start(dataset, law, share) for law in laws for share in tips]


def _build_start(dataset: Dataset, law: dict[str, float], share: float) -> Model:
    """Return a start with friction as `law` says and a share of the travel at the tip."""
    base, first = dataset.base, dataset.records[0]
    K = law.get(FRICTION.name, 0.0)
    total = _estimate_total_compliance(first)
    if first.loop:
        tip, compliance = share * total, 2.0 * (1.0 - share) * total
    elif COMPLIANCE in base.shared:
        plain = -math.expm1(-K) / K if K > 0.0 else 1.0
        tip, compliance = share * total * math.exp(K), (1.0 - share) * total / plain
    else:
        tip, compliance = total * math.exp(K), 0.0
    compliance = max(compliance, 1e-6)
    values = law | {COMPLIANCE.name: compliance, TIP_COMPLIANCE.name: tip}
    own = tuple(
        guess_record_parameters(record, base, compliance, tip) for record in dataset.records
    )
    return Model(tuple(values[p.name] for p in base.shared), own, ())


def build_tendon_starts(record: Record, law: BaseLaw) -> list[dict[str, float]]:
    """Return friction of a tendon to begin fits from, by name of the parameter."""
    if law is BaseLaw.CAPSTAN:
        return [{FRICTION.name: K} for K in START_FRICTIONS]
    T = record.signals[PROXIMAL_TENSION]
    forces = [share * float(np.quantile(T, 0.9)) for share in FORCE_SHARES]
    ways = [share * float(np.ptp(record.drive)) for share in WIDTH_SHARES]
    if record.driver == PROXIMAL_TENSION:
        ways = [share * SETTINGS.assumed_compliance * float(np.ptp(T)) for share in WIDTH_SHARES]
    return [
        {FRICTION.name: 0.2, FRICTION_FORCE.name: force, PRESLIDING_WIDTH.name: max(width, 2e-7)}
        for force in forces
        for width in ways
    ]


def build_loop_starts(record: Record, law: BaseLaw) -> list[dict[str, float]]:
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
            begin = {PRETENSION.name: pretension, FRICTION.name: K, FRICTION_FORCE.name: force}
            if law is BaseLaw.BOTH:
                begin |= {FRICTION.name: 0.5 * K, FRICTION_FORCE.name: 0.5 * force}
            starts += [begin | {PRESLIDING_WIDTH.name: max(width, 2e-7)} for width in widths]
    return starts


def _estimate_total_compliance(record: Record) -> float:
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


def _estimate_tip_shares(record: Record) -> tuple[float, ...]:
    if DISTAL_DISPLACEMENT not in record.signals:
        return TIP_SHARES
    if record.driver == PROXIMAL_TENSION:
        return (1.0,)
    tip = float(np.ptp(record.signals[DISTAL_DISPLACEMENT]))
    motor = float(np.ptp(record.signals[PROXIMAL_DISPLACEMENT]))
    return (min(max(tip / motor, 0.0), 0.95),)
