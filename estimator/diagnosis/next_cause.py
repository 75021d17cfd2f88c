"""Which candidate is the next cause, and which others the data do not distinguish from it."""

from estimator.diagnosis.dataset import Dataset, Fit
from estimator.diagnosis.outcome import Ranked, Step
from estimator.diagnosis.score import (
    Errors,
    bic_penalty,
    errors,
    gain_of,
    left_of,
    log_likelihood_ratio,
    surely_better,
)
from estimator.diagnosis.search import Candidate
from estimator.diagnosis.settings import SETTINGS


def next_cause(dataset: Dataset, plain: Fit, fit: Fit, found: list[Candidate]) -> Step | None:
    """Return the cause that explains most, with those that cannot be told from it, if any does."""
    base = errors(dataset, fit)
    order = sorted(found, key=lambda one: -score_of(dataset, base, one))
    if not order:
        return None
    best = simplest(dataset, plain, base, order)
    if (
        score_of(dataset, base, best) < SETTINGS.margin
        or gain_of(best.held_out, base) < SETTINGS.gain_min
        or surely_better(best.held_out, base) < SETTINGS.confidence
    ):
        return None
    most = left_of(best.held_out, errors(dataset, plain))
    rivals: list[str] = []
    for other in order:
        if other.effect.name in (best.effect.name, *rivals) or len(rivals) == SETTINGS.rivals_max:
            continue
        behind = score_of(dataset, base, best) - score_of(dataset, base, other)
        more = left_of(other.held_out, errors(dataset, plain)) - most
        unsure = (
            surely_better(best.held_out, other.held_out) < SETTINGS.confidence
            and more < SETTINGS.unsure_left
        )
        if behind < SETTINGS.alike or more < SETTINGS.alike_left or unsure:
            rivals.append(other.effect.name)
    return Step(best.effect, tuple(rivals), ranking(dataset, plain, fit, found), best.fit)


def simplest(
    dataset: Dataset, plain: Fit, base: dict[str, Errors], order: list[Candidate]
) -> Candidate:
    """Return of the best causes, which are as good as each other, that of the fewest parameters.

    One with more can imitate another: an antagonist of hardly any friction is joint friction.
    """
    best, at_first = order[0], errors(dataset, plain)
    most = left_of(best.held_out, at_first) + SETTINGS.alike_left
    least = score_of(dataset, base, best) - SETTINGS.alike
    alike = [
        one
        for one in order
        if score_of(dataset, base, one) > least and left_of(one.held_out, at_first) < most
    ]
    return min(alike, key=lambda one: len(one.effect.parameters))


def score_of(dataset: Dataset, base: dict[str, Errors], one: Candidate) -> float:
    """Return ln of how much more probable held-out data are, parameters paid for."""
    return log_likelihood_ratio(one.held_out, base) - bic_penalty(
        dataset, len(one.effect.parameters)
    )


def ranking(dataset: Dataset, plain: Fit, fit: Fit, found: list[Candidate]) -> tuple[Ranked, ...]:
    """Return the candidates of a search on top of a fit, the most probable first."""
    base, at_first = errors(dataset, fit), errors(dataset, plain)
    ranked = [
        Ranked(
            one.effect,
            score_of(dataset, base, one),
            {c: e.rmse for c, e in one.held_out.items()},
            left_of(one.held_out, at_first),
            one.fit.model.effects[-1][1],
        )
        for one in found
    ]
    return tuple(sorted(ranked, key=lambda one: -one.score))
