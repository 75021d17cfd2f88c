"""The search for causes: one after the other, from another first one, on another base law."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator.diagnosis.baseline import again
from estimator.diagnosis.dataset import Dataset, Fit, contexts, rescaled, with_records
from estimator.diagnosis.fit import improved
from estimator.diagnosis.hidden_motion import with_motion_beside
from estimator.diagnosis.law_choice import Choice, applicable, choose_loads
from estimator.diagnosis.layout import Layout
from estimator.diagnosis.needed_causes import LAST, matters, needed, without
from estimator.diagnosis.next_cause import next_cause, ranking, score_of
from estimator.diagnosis.outcome import Step
from estimator.diagnosis.progress import Report, part
from estimator.diagnosis.record import in_short_blocks
from estimator.diagnosis.score import (
    bic_penalty,
    errors,
    is_noise,
    left_of,
    log_likelihood_ratio,
    within,
)
from estimator.diagnosis.search import Candidate, candidates
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import Effect

SEARCHES = (0.1, 0.4, 0.55, 0.65)  # shares of the time between which each search for a cause runs
SAME = 0.01  # of a cost: an effect that does the same leads nowhere else
WORTH = 0.5  # of the error beyond noise, to which hidden motion must lower it
AGAIN = 0.9  # share at which a search that begins with another cause is done


class Found(NamedTuple):
    """Causes, and what they were found from."""

    loads: Choice
    dataset: Dataset
    plain: Fit  # the base law
    firsts: list[Candidate]  # of the first search
    steps: list[Step]
    fit: Fit  # of the base law with the causes


def find_causes(
    laws: Sequence[Choice],
    effects: Sequence[Effect],
    *,
    fit_all: bool,
    report: Report,
    workers: int,
) -> tuple[Found, Choice]:
    """Return the causes of what a base law leaves, and which of the base laws that is.

    A law may have been chosen because it imitates a cause. So those after the first are tried while
    more than noise is left, and the one stays with which most is explained.
    """
    tried: list[tuple[Found, Choice]] = []
    for law in laws:
        loads = choose_loads(law.dataset, law.fit)
        dataset, plain = loads.dataset, loads.fit
        if not fit_all and _brief(dataset, plain):
            dataset = with_records(dataset, [in_short_blocks(one) for one in dataset.records])
            plain = again(dataset, plain)
        plain = again(rescaled(dataset, plain), plain)  # weighed as its rivals will be
        tried.append((_one_by_one(loads, dataset, plain, effects, report, workers), law))
        if _is_explained(tried[-1][0]):
            break
    found, law = max(tried, key=lambda one: _evidence(one[0], tried[0][0]))
    if not _is_explained(found) and (moved := _moved_beside(found)) is not None:
        found = _one_by_one(found.loads, *moved, effects, report, workers)
    if not _is_explained(found):
        found = _from_another(found, effects, part(report, SEARCHES[-1], AGAIN), workers)
    return found, law


def _moved_beside(found: Found) -> tuple[Dataset, Fit] | None:
    """Return records with the hidden motion that shows beside a cause, and the base law's fit.

    A cause hides it from the base law. None where with it no more is explained.
    """
    dataset = found.dataset
    best = min(found.firsts, key=lambda one: one.cost, default=None)
    fit = found.fit if found.steps or best is None else best.fit
    about = contexts(dataset, found.plain)
    most = improved(dataset, about, fit.model, LAST, robust=True).model
    records = [
        with_motion_beside(record, context, dataset.base, most.shared, own, most.effects)
        for record, context, own in zip(dataset.records, about, most.own, strict=True)
    ]
    if all(new is old for new, old in zip(records, dataset.records, strict=True)):
        return None
    moved = with_records(dataset, records)
    plain = again(moved, found.plain)
    then = improved(rescaled(moved, fit), contexts(moved, plain), most, LAST)
    if left_of(errors(moved, then), errors(dataset, fit)) > WORTH:
        return None
    return rescaled(moved, plain), plain


def _is_explained(found: Found) -> bool:
    return is_noise(found.dataset, errors(found.dataset, found.fit))


def _evidence(a: Found, b: Found) -> float:
    """Return ln of how much more probable held-out data are by `a` than by `b`, numbers paid for.

    What is needed to choose `a` before `b` is taken off.
    """
    if a is b:
        return 0.0
    ratio = log_likelihood_ratio(errors(a.dataset, a.fit), errors(b.dataset, b.fit))
    more = len(Layout(a.dataset, a.fit.model).names) - len(Layout(b.dataset, b.fit.model).names)
    return ratio - bic_penalty(a.dataset, more) - SETTINGS.alike


def _one_by_one(
    loads: Choice,
    dataset: Dataset,
    plain: Fit,
    effects: Sequence[Effect],
    report: Report,
    workers: int,
) -> Found:
    """Return the causes of what the base law leaves, searched one after the other."""
    usable = applicable(effects, dataset.records[0], dataset.base)
    fit, steps, firsts = plain, list[Step](), list[Candidate]()
    for begin, end in itertools.pairwise(SEARCHES):
        if is_noise(dataset, errors(dataset, fit)) or (steps and _is_all(dataset, fit, plain)):
            break
        rest = [effect for effect in usable if effect.name not in fit.names]
        found = candidates(dataset, fit, rest, part(report, begin, end), workers)
        step = next_cause(dataset, plain, fit, found)
        if step is not None and not steps:
            less = without(dataset, step.fit, step.effect)
            if matters(dataset, step.fit, less, step.effect) < SETTINGS.margin:
                plain = fit = less  # the previous fit was a local minimum
                continue
        firsts = firsts or found
        if step is None:
            two = _by_two(
                dataset, plain, fit, found, rest, part(report, end, SEARCHES[-1]), workers
            )
            steps, fit = [*steps, *two], two[-1].fit if two else fit
            break
        steps.append(step)
        fit = step.fit
    return Found(loads, dataset, plain, firsts, *needed(dataset, plain, steps, fit))


def _from_another(found: Found, effects: Sequence[Effect], report: Report, workers: int) -> Found:
    """Return better causes of which another is the first, if there are any.

    The effect that explains most alone is not always one of those that together explain all: plays
    of many thresholds imitate the gain of a load cell, badly.
    """
    dataset, plain = found.dataset, found.plain
    usable = applicable(effects, dataset.records[0], dataset.base)
    names = {step.effect.name for step in found.steps[:1]}
    first = min(
        (one for one in found.firsts if one.effect.name in names or not names),
        key=lambda one: one.cost,
        default=None,
    )
    others = [
        one
        for one in found.firsts
        if first is not None
        and one.effect.name != first.effect.name
        and abs(one.cost / first.cost - 1.0) > SAME
    ]
    if not others:
        return found
    base = errors(dataset, plain)
    lead = max(others, key=lambda one: score_of(dataset, base, one))
    order = ranking(dataset, plain, plain, found.firsts)
    steps, fit = [Step(lead.effect, (), order, lead.fit)], lead.fit
    for share in (0.0, 0.5):
        if is_noise(dataset, errors(dataset, fit)) or _is_all(dataset, fit, plain):
            break
        rest = [effect for effect in usable if effect.name not in fit.names]
        more = candidates(dataset, fit, rest, part(report, share, share + 0.5), workers)
        step = next_cause(dataset, plain, fit, more)
        if step is None:
            break
        steps.append(step)
        fit = step.fit
    steps, fit = needed(dataset, plain, steps, fit)
    other = found._replace(steps=steps, fit=fit)
    sure = found.steps or within(dataset, errors(dataset, fit), SETTINGS.further)  # see `_by_two`
    return other if len(steps) > 1 and sure and _evidence(other, found) > 0.0 else found


def _by_two(
    dataset: Dataset,
    plain: Fit,
    fit: Fit,
    found: Sequence[Candidate],
    rest: Sequence[Effect],
    report: Report,
    workers: int,
) -> list[Step]:
    """Return two causes, none of which is worth it alone, if together they leave only noise.

    One of two can make a quiet channel worse while it takes most away from a loud one. It must fit
    far better than any other, since nothing else speaks for it yet.
    """
    ahead = sorted(found, key=lambda one: one.cost)
    others = [one.cost for one in ahead if one.effect.name != ahead[0].effect.name] if ahead else []
    if not others or ahead[0].cost * SETTINGS.ahead > min(others):
        return []
    lead = ahead[0]
    rest = [effect for effect in rest if effect.name != lead.effect.name]
    more = candidates(dataset, lead.fit, rest, report, workers)
    second = next_cause(dataset, plain, lead.fit, more)
    if second is None or not within(dataset, errors(dataset, second.fit), SETTINGS.further):
        return []
    return [Step(lead.effect, (), ranking(dataset, plain, fit, list(found)), lead.fit), second]


def _is_all(dataset: Dataset, fit: Fit, plain: Fit) -> bool:
    """Return whether too little is left for another cause to be told from model error."""
    found = errors(dataset, fit)
    if left_of(found, errors(dataset, plain)) < SETTINGS.left_min:
        return True
    return within(dataset, found, SETTINGS.further)


def _brief(dataset: Dataset, plain: Fit) -> bool:
    """Return whether what is wrong is nearly all in one block, or in two side by side."""
    most = total = 0.0
    for record, one in zip(dataset.records, plain.simulated, strict=True):
        excess = np.zeros(record.block[-1] + 1)
        for channel in record.compared:
            good = record.good[channel]
            off = (one.signals[channel] - record.signals[channel])[good] / record.sigma[channel][
                good
            ]
            excess += np.bincount(record.block[good], off**2 - 1.0, len(excess))
        excess = np.maximum(excess, 0.0)
        most = max(most, float(np.convolve(excess, np.ones(2)).max()))
        total += float(excess.sum())
    return most > SETTINGS.brief * total
