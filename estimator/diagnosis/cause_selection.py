"""Which candidate is the next cause, and the rivals that explain the data as well."""

from collections.abc import Sequence
from typing import NamedTuple

from estimator.diagnosis.dataset import (
    Dataset,
    Fit,
    Model,
    build_contexts,
    rescale_residuals,
    use_all_samples,
)
from estimator.diagnosis.fit import fit_model
from estimator.diagnosis.outcome import CauseStep, RankedCandidate, Rival
from estimator.diagnosis.scoring import (
    ChannelErrors,
    bootstrap_superiority,
    compute_errors,
    compute_likelihood_gain,
    compute_residual_fraction,
)
from estimator.diagnosis.screening import Candidate, score_candidate
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import Effect, Values

ROUNDS = 12  # of the fit to all samples


class CauseError(ValueError):
    """A cause that was asked for is not among those that explain the data equally well."""


class EquivalentCause(NamedTuple):
    """An effect that explains as much as one of the causes, with its first values."""

    replaces: str  # name of that cause
    effect: Effect
    values: Values


def find_next_cause(
    dataset: Dataset, base_fit: Fit, current_fit: Fit, candidates: list[Candidate]
) -> CauseStep | None:
    """Return the cause that explains most, with its rivals; None if no cause is significant.

    Rivals are other effects that the data do not distinguish from it.
    """
    current_errors = compute_errors(dataset, current_fit)
    base_errors = compute_errors(dataset, base_fit)
    ranked = sorted(
        candidates, key=lambda candidate: -score_candidate(dataset, current_errors, candidate)
    )
    if not ranked:
        return None
    best = select_simplest_cause(dataset, base_fit, current_errors, ranked)
    best_score = score_candidate(dataset, current_errors, best)
    if (
        best_score < SETTINGS.score_min
        or compute_likelihood_gain(best.held_out, current_errors) < SETTINGS.gain_min
        or bootstrap_superiority(best.held_out, current_errors) < SETTINGS.confidence
    ):
        return None
    rivals = find_rivals(dataset, base_errors, current_errors, best, ranked)
    ranking = rank_candidates(dataset, base_fit, current_fit, candidates)
    return CauseStep(best.effect, rivals, ranking, best.fit)


def select_simplest_cause(
    dataset: Dataset,
    base_fit: Fit,
    current_errors: dict[str, ChannelErrors],
    ranked: list[Candidate],
) -> Candidate:
    """Return the candidate with the fewest parameters among those as good as the best.

    An effect with more parameters can imitate another one: an antagonist with hardly any friction
    is joint friction.
    """
    best, base_errors = ranked[0], compute_errors(dataset, base_fit)
    fraction_max = (
        compute_residual_fraction(best.held_out, base_errors) + SETTINGS.equivalent_fraction_max
    )
    score_min = score_candidate(dataset, current_errors, best) - SETTINGS.equivalent_score_max
    equivalents = [
        candidate
        for candidate in ranked
        if score_candidate(dataset, current_errors, candidate) > score_min
        and compute_residual_fraction(candidate.held_out, base_errors) < fraction_max
    ]
    return min(equivalents, key=lambda candidate: candidate.effect.degrees)


def rank_candidates(
    dataset: Dataset, base_fit: Fit, current_fit: Fit, candidates: list[Candidate]
) -> tuple[RankedCandidate, ...]:
    """Return the candidates of a search on top of `current_fit`, the most probable first."""
    current_errors = compute_errors(dataset, current_fit)
    base_errors = compute_errors(dataset, base_fit)
    ranked = [
        RankedCandidate(
            candidate.effect,
            score_candidate(dataset, current_errors, candidate),
            {channel: errors.rmse for channel, errors in candidate.held_out.items()},
            compute_residual_fraction(candidate.held_out, base_errors),
            candidate.fit.model.effects[-1][1],
        )
        for candidate in candidates
    ]
    return tuple(sorted(ranked, key=lambda candidate: -candidate.score))


def find_rivals(
    dataset: Dataset,
    base_errors: dict[str, ChannelErrors],
    current_errors: dict[str, ChannelErrors],
    best: Candidate,
    ranked: list[Candidate],
) -> tuple[str, ...]:
    """Return the names of the effects that the data do not distinguish from the best."""
    best_score = score_candidate(dataset, current_errors, best)
    best_fraction = compute_residual_fraction(best.held_out, base_errors)
    rivals: list[str] = []
    for candidate in ranked:
        name = candidate.effect.name
        if name in (best.effect.name, *rivals) or len(rivals) == SETTINGS.rivals_max:
            continue
        score_deficit = best_score - score_candidate(dataset, current_errors, candidate)
        fraction = compute_residual_fraction(candidate.held_out, base_errors)
        extra_fraction = fraction - best_fraction
        is_uncertain = (
            bootstrap_superiority(best.held_out, candidate.held_out) < SETTINGS.confidence
            and extra_fraction < SETTINGS.uncertain_fraction_max
        )
        if (
            score_deficit < SETTINGS.equivalent_score_max
            or extra_fraction < SETTINGS.equivalent_fraction_max
            or is_uncertain
        ):
            rivals.append(name)
    return tuple(rivals)


def fit_rivals(
    dataset: Dataset, base_fit: Fit, fit: Fit, equivalents: Sequence[EquivalentCause]
) -> tuple[Rival, ...]:
    """Return the models of all rivals."""
    full_dataset = rescale_residuals(use_all_samples(dataset), fit)
    contexts = build_contexts(dataset, base_fit)
    return tuple(
        Rival(
            equivalent.replaces,
            equivalent.effect,
            fit_model(full_dataset, contexts, replace_cause(fit.model, equivalent), ROUNDS),
        )
        for equivalent in equivalents
    )


def replace_cause(model: Model, equivalent: EquivalentCause) -> Model:
    """Return a model with a rival in the place of its cause."""
    effects = tuple(
        (equivalent.effect, equivalent.values)
        if effect.name == equivalent.replaces
        else (effect, values)
        for effect, values in model.effects
    )
    return model._replace(effects=effects)


# --- causes that explain the data equally well, and the choice among them


def choose_equivalent_cause(
    dataset: Dataset, base_fit: Fit, steps: list[CauseStep], fit: Fit, cause: str
) -> tuple[list[CauseStep], Fit]:
    """Return the causes with one of equally good ones in the place of the first of them."""
    if cause in [step.effect.name for step in steps]:
        return steps, fit
    equivalents = {
        equivalent.effect.name: equivalent for equivalent in find_equivalent_causes(steps)
    }
    if cause not in equivalents:
        raise _build_cause_error(cause, [*(step.effect.name for step in steps), *equivalents])
    chosen = equivalents[cause]
    fit = fit_model(
        rescale_residuals(dataset, fit),
        build_contexts(dataset, base_fit),
        replace_cause(fit.model, chosen),
        ROUNDS,
    )
    return [
        CauseStep(
            chosen.effect,
            (step.effect.name, *(name for name in step.rivals if name != cause)),
            step.ranking,
            fit,
        )
        if step.effect.name == chosen.replaces
        else step
        for step in steps
    ], fit


def _build_cause_error(cause: str, names: Sequence[str]) -> CauseError:
    if not names:
        return CauseError(f"{cause}: no cause was found in these data; leave it out")
    listed = ", ".join(dict.fromkeys(names))
    return CauseError(f"{cause}: does not explain these data equally well; choose from {listed}")


def find_equivalent_causes(steps: Sequence[CauseStep]) -> list[EquivalentCause]:
    """Return the effects that explain as much as the causes, each in its best variant."""
    causes = [step.effect.name for step in steps]
    equivalents = []
    for step in steps:
        for name in step.rivals:
            if name not in causes:
                ranked = next(candidate for candidate in step.ranking if candidate.name == name)
                equivalents.append(EquivalentCause(step.effect.name, ranked.effect, ranked.values))
    return equivalents
