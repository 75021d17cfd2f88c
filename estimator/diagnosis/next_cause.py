"""Which candidate is the next cause, and which others the data do not distinguish from it."""

from estimator.diagnosis.dataset import Dataset, Fit
from estimator.diagnosis.outcome import CauseStep, RankedCandidate
from estimator.diagnosis.score import (
    ChannelErrors,
    bootstrap_superiority,
    compute_bic_penalty,
    compute_errors,
    compute_gain,
    compute_log_likelihood_ratio,
    compute_residual_fraction,
)
from estimator.diagnosis.search import Candidate
from estimator.diagnosis.settings import SETTINGS


def find_next_cause(
    dataset: Dataset, plain: Fit, fit: Fit, found: list[Candidate]
) -> CauseStep | None:
    """Return the cause that explains most, with those that cannot be told from it, if any does."""
    base = compute_errors(dataset, fit)
    order = sorted(found, key=lambda one: -score_candidate(dataset, base, one))
    if not order:
        return None
    best = select_simplest_cause(dataset, plain, base, order)
    if (
        score_candidate(dataset, base, best) < SETTINGS.margin
        or compute_gain(best.held_out, base) < SETTINGS.gain_min
        or bootstrap_superiority(best.held_out, base) < SETTINGS.confidence
    ):
        return None
    most = compute_residual_fraction(best.held_out, compute_errors(dataset, plain))
    rivals: list[str] = []
    for other in order:
        if other.effect.name in (best.effect.name, *rivals) or len(rivals) == SETTINGS.rivals_max:
            continue
        behind = score_candidate(dataset, base, best) - score_candidate(dataset, base, other)
        more = compute_residual_fraction(other.held_out, compute_errors(dataset, plain)) - most
        unsure = (
            bootstrap_superiority(best.held_out, other.held_out) < SETTINGS.confidence
            and more < SETTINGS.unsure_left
        )
        if behind < SETTINGS.alike or more < SETTINGS.alike_left or unsure:
            rivals.append(other.effect.name)
    return CauseStep(
        best.effect, tuple(rivals), rank_candidates(dataset, plain, fit, found), best.fit
    )


def select_simplest_cause(
    dataset: Dataset, plain: Fit, base: dict[str, ChannelErrors], order: list[Candidate]
) -> Candidate:
    """Return of the best causes, which are as good as each other, that of the fewest parameters.

    One with more can imitate another: an antagonist of hardly any friction is joint friction.
    """
    best, at_first = order[0], compute_errors(dataset, plain)
    most = compute_residual_fraction(best.held_out, at_first) + SETTINGS.alike_left
    least = score_candidate(dataset, base, best) - SETTINGS.alike
    alike = [
        one
        for one in order
        if score_candidate(dataset, base, one) > least
        and compute_residual_fraction(one.held_out, at_first) < most
    ]
    return min(alike, key=lambda one: len(one.effect.parameters))


def score_candidate(dataset: Dataset, base: dict[str, ChannelErrors], one: Candidate) -> float:
    """Return ln of how much more probable held-out data are, parameters paid for."""
    return compute_log_likelihood_ratio(one.held_out, base) - compute_bic_penalty(
        dataset, len(one.effect.parameters)
    )


def rank_candidates(
    dataset: Dataset, plain: Fit, fit: Fit, found: list[Candidate]
) -> tuple[RankedCandidate, ...]:
    """Return the candidates of a search on top of a fit, the most probable first."""
    base, at_first = compute_errors(dataset, fit), compute_errors(dataset, plain)
    ranked = [
        RankedCandidate(
            one.effect,
            score_candidate(dataset, base, one),
            {c: e.rmse for c, e in one.held_out.items()},
            compute_residual_fraction(one.held_out, at_first),
            one.fit.model.effects[-1][1],
        )
        for one in found
    ]
    return tuple(sorted(ranked, key=lambda one: -one.score))
