"""The baseline of a diagnosis: the base law, and the choice of it."""

import math
from collections.abc import Sequence

import numpy as np

from estimator.diagnosis.dataset import (
    COMPLIANCE,
    EXCLUDED_EFFECTS,
    FRICTION,
    FRICTION_FORCE,
    PRESLIDING_WIDTH,
    PRETENSION,
    TIP_COMPLIANCE,
    TIP_MASS,
    BaseLaw,
    BaseParameters,
    Dataset,
    Fit,
    LoadModel,
    Model,
    build_dataset,
    build_unsimulated_contexts,
    compute_cost,
    simulate_dataset,
    subsample,
)
from estimator.diagnosis.fit import (
    BASELINE_ROUNDS,
    build_initial_contexts,
    fit_model,
    guess_record_parameters,
    refit_baseline,
)
from estimator.diagnosis.record import Record
from estimator.diagnosis.scoring import (
    Choice,
    ChoiceScore,
    compute_errors,
    compute_log_likelihood_ratio,
)
from estimator.diagnosis.screening import map_parallel
from estimator.diagnosis.settings import SETTINGS, ignore_progress
from estimator.effects.effect import (
    DISTAL_DISPLACEMENT,
    PROXIMAL_DISPLACEMENT,
    PROXIMAL_TENSION,
    Effect,
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
SAME_MINIMUM = 1e-3  # of a cost, by which descents that end at one minimum differ
SUBSAMPLE_SIZE = 1500  # samples of a record


def fit_baseline(dataset: Dataset, workers: int = 1) -> Fit:
    """Return the best fit of the base law: from many starts on few samples, then on all.

    Starts are fitted two at a time, by up to `workers` threads, until two lead to one minimum.
    """
    subsampled = subsample(dataset, SUBSAMPLE_SIZE)
    contexts = build_initial_contexts(subsampled)
    starts = _build_starts(subsampled)
    costs = [
        compute_cost(subsampled, simulate_dataset(subsampled, contexts, model)) for model in starts
    ]
    models = [starts[k] for k in np.argsort(costs)[:STARTS_KEPT]]
    fits: list[tuple[float, Fit]] = []

    def fit_start(start: Model) -> tuple[float, Fit]:
        fit = fit_model(subsampled, contexts, start, BASELINE_ROUNDS)
        return compute_cost(subsampled, fit), fit

    for k in range(0, len(models), 2):
        pair = models[k : k + 2]
        fits += map_parallel(fit_start, pair, ignore_progress, "fitting the base law", workers)
        fits.sort(key=lambda pair: pair[0])
        if len(fits) > 1 and math.isclose(fits[0][0], fits[1][0], rel_tol=SAME_MINIMUM):
            break
    return refit_baseline(dataset, fits[0][1])


def _build_starts(dataset: Dataset) -> list[Model]:
    base, first_record = dataset.base, dataset.records[0]
    build_starts = build_loop_starts if first_record.loop else build_tendon_starts
    laws = build_starts(first_record, base.law)
    tips = (
        _estimate_tip_shares(first_record)
        if TIP_COMPLIANCE in (*base.shared, *base.own)
        else (0.0,)
    )
    return [_build_start(dataset, law, share) for law in laws for share in tips]


def _build_start(dataset: Dataset, law: dict[str, float], share: float) -> Model:
    """Return a start with friction as `law` says and a share of the travel at the tip."""
    base, first_record = dataset.base, dataset.records[0]
    K = law.get(FRICTION.name, 0.0)
    total = _estimate_total_compliance(first_record)
    if first_record.loop:
        tip, compliance = share * total, 2.0 * (1.0 - share) * total
    elif COMPLIANCE in base.shared:
        mean_tension_ratio = -math.expm1(-K) / K if K > 0.0 else 1.0
        tip, compliance = share * total * math.exp(K), (1.0 - share) * total / mean_tension_ratio
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
    widths = [share * float(np.ptp(record.drive)) for share in WIDTH_SHARES]
    if record.driver == PROXIMAL_TENSION:
        widths = [share * SETTINGS.assumed_compliance * float(np.ptp(T)) for share in WIDTH_SHARES]
    return [
        {FRICTION.name: 0.2, FRICTION_FORCE.name: force, PRESLIDING_WIDTH.name: max(width, 2e-7)}
        for force in forces
        for width in widths
    ]


def build_loop_starts(record: Record, law: BaseLaw) -> list[dict[str, float]]:
    """Return friction and pretension of a loop to begin fits from, by name of the parameter.

    A loop whose cables rub with F each takes 2 F to turn, F about K times the pretension.
    """
    T = record.signals[PROXIMAL_TENSION]
    peak_tension = float(np.abs(T).max())
    widths = [share * float(np.ptp(record.drive)) for share in WIDTH_SHARES]
    starts = []
    for pretension in (share * peak_tension for share in PRETENSION_SHARES):
        for force in (share * peak_tension for share in FORCE_SHARES):
            K = min(max(force / pretension, 0.02), 3.0)
            start = {PRETENSION.name: pretension, FRICTION.name: K, FRICTION_FORCE.name: force}
            if law is BaseLaw.BOTH:
                start |= {FRICTION.name: 0.5 * K, FRICTION_FORCE.name: 0.5 * force}
            starts += [start | {PRESLIDING_WIDTH.name: max(width, 2e-7)} for width in widths]
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
    is_taut = 0.1 * float(T.max()) < T
    is_pulling = is_taut & (record.speed > 0.1 * float(np.abs(record.speed).max()))
    rows = is_pulling if is_pulling.sum() > 10 else is_taut
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


# --- which base law a transmission has, by the likelihood of samples that were not fitted

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

JOINT_EFFECTS = frozenset({"link_gravity"})  # that are defined by the angle of a loop only


def choose_law(dataset: Dataset, base_fit: Fit, workers: int = 1) -> Choice:
    """Return the base law that held-out samples favour; `base_fit` is the fitted capstan law.

    Of a loop, the one of highest score; of those as good, the one of fewest parameters. A tendon
    stays with the capstan law and its effects, unless friction that no load changes is better alone
    and tension adds nothing to it.
    """
    independent_dataset = build_dataset(dataset.records, BaseLaw.INDEPENDENT)
    trials = [
        (dataset, base_fit),
        (independent_dataset, fit_baseline(independent_dataset, workers)),
    ]
    trials.append(_fit_combined_law(trials, workers))
    trials = [*(_refit_from(trials[-1], trial) for trial in trials[:-1]), trials[-1]]
    scores = _score_choices(trials, [entry.base.law for entry, _ in trials])
    capstan, independent, combined = (entry.score for entry in scores)
    best_score = max(capstan, independent, combined)
    if dataset.records[0].loop:
        chosen = next(
            i
            for i, entry in enumerate(scores)
            if best_score - entry.score < SETTINGS.equivalent_score_max
        )
    else:
        is_independent_better = independent - capstan > SETTINGS.score_min
        chosen = int(
            is_independent_better and best_score - independent < SETTINGS.equivalent_score_max
        )
    return Choice(*trials[chosen], scores)


def choose_loads(dataset: Dataset, fit: Fit) -> Choice:
    """Return whether several files have a load at the tip each, or one together."""
    base = dataset.base
    if len(dataset.records) < 2 or TIP_COMPLIANCE not in base.shared:
        return Choice(dataset, fit, ())
    trials = [(dataset, fit)]
    for loads in (LoadModel.SPRINGS, LoadModel.MASSES):
        variant = build_dataset(dataset.records, base.law, loads)
        contexts = build_unsimulated_contexts(*trials[-1])
        start = _convert_load_model(trials[-1][0], trials[-1][1].model, variant)
        trials.append((variant, fit_model(variant, contexts, start, LAW_ROUNDS)))
    scores = _score_choices(trials, [entry.base.loads for entry, _ in trials])
    shared, springs, masses = (entry.score for entry in scores)
    if max(springs, masses) - shared < SETTINGS.score_min:
        return Choice(dataset, fit, scores)
    return Choice(*trials[2 if masses - springs > SETTINGS.score_min else 1], scores)


def select_applicable_effects(
    effects: Sequence[Effect], record: Record, base: BaseParameters
) -> list[Effect]:
    """Return the effects with a law that are defined for a record's channels and its base law."""
    excluded = EXCLUDED_EFFECTS[base.law] | ({"tip_inertia"} if TIP_MASS in base.own else set())
    return [
        effect
        for effect in effects
        if effect.function is None
        and effect.required_channels <= set(record.signals)
        and effect.name not in excluded
        and _is_defined_for(effect, record)
    ]


def _is_defined_for(effect: Effect, record: Record) -> bool:
    if effect.name in JOINT_EFFECTS:
        return record.loop and record.units.rotary
    return not record.loop or effect.name in LOOP_EFFECTS or effect.label in LOOP_EFFECTS


def _score_choices(
    trials: Sequence[tuple[Dataset, Fit]], names: Sequence[str]
) -> tuple[ChoiceScore, ...]:
    errors = [compute_errors(*entry) for entry in trials]
    parameter_counts = [_count_parameters(entry) for entry, _ in trials]
    samples = sum(len(record.time) for record in trials[0][0].records)
    return tuple(
        ChoiceScore(
            str(name),
            compute_log_likelihood_ratio(entry, errors[0])
            - 0.5 * (count - parameter_counts[0]) * float(np.log(samples)),
            {channel: channel_errors.rmse for channel, channel_errors in entry.items()},
        )
        for name, entry, count in zip(names, errors, parameter_counts, strict=True)
    )


def _count_parameters(dataset: Dataset) -> int:
    return len(dataset.base.shared) + len(dataset.base.own) * len(dataset.records)


def _refit_from(combined: tuple[Dataset, Fit], trial: tuple[Dataset, Fit]) -> tuple[Dataset, Fit]:
    """Return the better of a law's fit and one begun at the combined law's, without the rest.

    A law whose descents all end beside its minimum would lose to the one that contains it.
    """
    dataset, fit = trial
    (whole, whole_fit), model = combined, combined[1].model
    values = whole.base.values(model.shared, model.own[0])
    start = model._replace(shared=tuple(values[p.name] for p in dataset.base.shared))
    refit = fit_model(dataset, build_unsimulated_contexts(whole, whole_fit), start, LAW_ROUNDS)
    return dataset, min((fit, refit), key=lambda candidate: compute_cost(dataset, candidate))


def _fit_combined_law(trials: Sequence[tuple[Dataset, Fit]], workers: int) -> tuple[Dataset, Fit]:
    """Return the combined law, started from the fit of each law with a little of the other."""
    combined = build_dataset(trials[0][0].records, BaseLaw.BOTH)

    def fit_from(trial: tuple[Dataset, Fit]) -> Fit:
        dataset, model = trial[0], trial[1].model
        values = {FRICTION.name: START_FRICTION_SHARE, PRESLIDING_WIDTH.name: PRESLIDING_WIDTH.step}
        values |= dataset.base.values(model.shared, model.own[0])
        values.setdefault(
            FRICTION_FORCE.name, START_FRICTION_SHARE * max(values.get(PRETENSION.name, 0.0), 1.0)
        )
        start = model._replace(shared=tuple(values[p.name] for p in combined.base.shared))
        return fit_model(combined, build_unsimulated_contexts(*trial), start, LAW_ROUNDS)

    fits = map_parallel(fit_from, trials, ignore_progress, "fitting the combined law", workers)
    return combined, min(fits, key=lambda fit: compute_cost(combined, fit))


def _convert_load_model(dataset: Dataset, model: Model, target: Dataset) -> Model:
    """Return a model with the parameters of another choice of loads, from its own values."""
    own = []
    for record, numbers in zip(dataset.records, model.own, strict=True):
        values = dataset.base.values(model.shared, numbers)
        guessed = dict(
            zip(
                (p.name for p in target.base.own),
                guess_record_parameters(record, target.base, 0.0),
                strict=True,
            )
        )
        own.append(tuple(values.get(p.name, guessed[p.name]) for p in target.base.own))
    values = dataset.base.values(model.shared, model.own[0])
    return model._replace(shared=tuple(values[p.name] for p in target.base.shared), own=tuple(own))
