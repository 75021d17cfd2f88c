"""Which further effect lets a model carry over to other motions.

Held-out blocks lie between fitted ones and have like motions: an effect that matters elsewhere may
gain nothing there. So each record is also cut in two, a model is fitted to one half and judged by
the other, both ways.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from estimator.diagnosis.dataset import Dataset, Fit, contexts, rescaled, whole
from estimator.diagnosis.fit import refitted
from estimator.diagnosis.score import Errors, errors, gain_of, joined, log_likelihood_ratio
from estimator.diagnosis.search import Candidate
from estimator.diagnosis.settings import SETTINGS
from estimator.effects.effect import Effect

TRIED = 3  # effects
ROUNDS = 12  # of a fit to one half


class Offer(NamedTuple):
    """An effect that is not named, with which the model predicts the halves better."""

    effect: Effect
    fit: Fit  # the model with it
    without: dict[str, float]  # RMSE of halves that the other half predicts, by channel
    rmse: dict[str, float]  # the same with it


def offered(
    dataset: Dataset, plain: Fit, fit: Fit, found: Sequence[Candidate], tolerated: dict[str, float]
) -> Offer | None:
    """Return the effect with which a model carries over best, if it does better than without any.

    It must be better both ways. Effects of one time belong to their record and are left out.

    Parameters
    ----------
    dataset : Dataset
        What was measured.
    plain, fit : Fit
        The plain law, and the model.
    found : sequence of Candidate
        Effects on top of it, none of which held-out blocks speak for.
    tolerated : dict
        Mean square of each channel that needs no cause, in noise variances.
    """
    lasting = [one for one in found if not any(p.jumps for p in one.effect.parameters)]
    first: dict[str, Candidate] = {}
    for one in sorted(lasting, key=lambda one: one.cost):
        first.setdefault(one.effect.name, one)
    before = by_halves(dataset, plain, fit)
    best, most = None, SETTINGS.carried_gain
    for one in list(first.values())[:TRIED]:
        after = by_halves(dataset, plain, one.fit)
        better = all(
            log_likelihood_ratio(a, b, tolerated) > 0.0 for a, b in zip(after, before, strict=True)
        )
        gain = gain_of(joined(after), joined(before), tolerated)
        if better and gain > most:
            best, most = Offer(one.effect, one.fit, _rmse(before), _rmse(after)), gain
    return best


def by_halves(dataset: Dataset, plain: Fit, fit: Fit) -> list[dict[str, Errors]]:
    """Return the errors of both halves of all records, each by a model fitted to the other."""
    about, full = contexts(dataset, plain), whole(dataset)
    found = []
    for is_first in (True, False):
        half = dataset._replace(
            records=tuple(
                replace(record, train=(record.time < np.median(record.time)) == is_first)
                for record in dataset.records
            )
        )
        one = refitted(rescaled(half, fit), rescaled(full, fit), about, fit, ROUNDS)
        found.append(errors(half, one))
    return found


def _rmse(halves: Sequence[dict[str, Errors]]) -> dict[str, float]:
    return {channel: one.rmse for channel, one in joined(halves).items()}
