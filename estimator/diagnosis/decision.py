"""When an effect is named: what it scores on held-out samples, and what cannot be told from it."""

import math

from estimator.diagnosis import equal_causes
from estimator.diagnosis.dataset import Dataset, Fit, tolerance
from estimator.diagnosis.outcome import Ranked, Step
from estimator.diagnosis.score import (
    Errors,
    errors,
    gain_of,
    left_of,
    log_likelihood_ratio,
    surely_better,
)
from estimator.diagnosis.search import Candidate
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import Effect


def next_step(dataset: Dataset, plain: Fit, fit: Fit, found: list[Candidate]) -> Step | None:
    """Return the cause that explains most, with those that cannot be told from it, if any does."""
    base = errors(dataset, fit)
    order = sorted(found, key=lambda one: -_score(dataset, base, one))
    if not order:
        return None
    best = _simplest(dataset, plain, base, order)
    if (
        _score(dataset, base, best) < SETTINGS.margin
        or gain_of(best.held_out, base, tolerated(dataset)) < SETTINGS.gain_min
        or surely_better(best.held_out, base) < SETTINGS.confidence
    ):
        return None
    most = left_of(best.held_out, errors(dataset, plain))
    rivals: list[str] = []
    for other in order:
        if other.effect.is_same_cause(best.effect) or len(rivals) == SETTINGS.rivals_max:
            continue
        name = equal_causes.rival_name(other.effect, best.effect)
        if name in rivals:
            continue
        behind = max(
            score(dataset, base, best) - score(dataset, base, other)
            for score in (_score, _fine_score)
        )
        more = left_of(other.held_out, errors(dataset, plain)) - most
        unsure = (
            surely_better(best.held_out, other.held_out) < SETTINGS.confidence
            and more < SETTINGS.unsure_left
        )
        if behind < SETTINGS.alike or more < SETTINGS.alike_left or unsure:
            rivals.append(name)
    return Step(best.effect, tuple(rivals), ranking(dataset, plain, fit, found), best.fit)


def _simplest(
    dataset: Dataset, plain: Fit, base: dict[str, Errors], order: list[Candidate]
) -> Candidate:
    """Return of the best causes, which are as good as each other, that of the fewest parameters.

    One with more can imitate another: an antagonist of hardly any friction is joint friction.
    """
    at_first = errors(dataset, plain)
    ahead = _score(dataset, base, order[0]) - SETTINGS.alike
    near = [one for one in order if _score(dataset, base, one) > ahead]
    best = max(near, key=lambda one: _fine_score(dataset, base, one))
    most = left_of(best.held_out, at_first) + SETTINGS.alike_left
    least = _fine_score(dataset, base, best) - SETTINGS.alike
    alike = [
        one
        for one in near
        if _fine_score(dataset, base, one) > least and left_of(one.held_out, at_first) < most
    ]
    return min(alike, key=lambda one: len(one.effect.parameters))


def ranking(dataset: Dataset, plain: Fit, fit: Fit, found: list[Candidate]) -> tuple[Ranked, ...]:
    """Return how the candidates of one search came out, the best first."""
    base, at_first = errors(dataset, fit), errors(dataset, plain)
    size = dataset.records[0].units.size
    ranked = [
        Ranked(
            one.effect.name,
            one.effect.label,
            _score(dataset, base, one),
            {c: e.rmse for c, e in one.held_out.items()},
            left_of(one.held_out, at_first),
            {
                p.name: size(p.unit) * value
                for p, value in zip(
                    one.effect.parameters, one.fit.model.effects[-1][1], strict=True
                )
            },
        )
        for one in found
    ]
    return tuple(sorted(ranked, key=lambda one: -one.score))


def _score(dataset: Dataset, base: dict[str, Errors], one: Candidate) -> float:
    """Return ln of how much more probable held-out data are, parameters paid for.

    Errors that are tolerated need no cause: what makes them smaller scores nothing.
    """
    found = log_likelihood_ratio(one.held_out, base, tolerated(dataset))
    return found - _bic_penalty(dataset, one.effect)


def _fine_score(dataset: Dataset, base: dict[str, Errors], one: Candidate) -> float:
    """Return the same of all errors, however small: it tells causes apart that score alike."""
    return log_likelihood_ratio(one.held_out, base) - _bic_penalty(dataset, one.effect)


def score_beside(dataset: Dataset, fit: Fit, without: Fit, effect: Effect) -> float:
    """Return what an effect scores beside all others of a model."""
    found = log_likelihood_ratio(errors(dataset, fit), errors(dataset, without), tolerated(dataset))
    return found - _bic_penalty(dataset, effect)


def _bic_penalty(dataset: Dataset, effect: Effect) -> float:
    samples = sum(len(record.time) for record in dataset.records)
    return 0.5 * len(effect.parameters) * math.log(samples)


def is_noise(dataset: Dataset, found: dict[str, Errors]) -> bool:
    """Return whether errors are what noise makes, and a simulation's own error."""
    return is_within(dataset, found, SETTINGS.noise_ratio)


def is_all(dataset: Dataset, fit: Fit, plain: Fit) -> bool:
    """Return whether too little is left for another cause to be told from model error."""
    found = errors(dataset, fit)
    if left_of(found, errors(dataset, plain)) < SETTINGS.left_min:
        return True
    return is_within(dataset, found, SETTINGS.further)


def is_within(dataset: Dataset, found: dict[str, Errors], times: float) -> bool:
    """Return whether the errors of all channels are below so many times the tolerance."""
    floor = tolerance(dataset)
    return all(math.sqrt(one.mean) < times * floor[c] for c, one in found.items())


def tolerated(dataset: Dataset) -> dict[str, float]:
    """Return the mean square of each channel that noise and the simulation's own error make."""
    return {channel: floor**2 for channel, floor in tolerance(dataset).items()}
