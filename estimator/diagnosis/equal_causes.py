"""Causes that explain the data equally well, and the choice among them."""

from collections.abc import Sequence

from estimator.diagnosis.dataset import Dataset, Fit, contexts, rescaled
from estimator.diagnosis.fit import improved
from estimator.diagnosis.outcome import Step
from estimator.diagnosis.rivals import ROUNDS, CauseError, Equal, replaced


def with_cause(
    dataset: Dataset,
    plain: Fit,
    steps: list[Step],
    fit: Fit,
    cause: str,
) -> tuple[list[Step], Fit]:
    """Return the causes with one of equally good ones in the place of the first of them."""
    if cause in [step.effect.name for step in steps]:
        return steps, fit
    known = {one.effect.name: one for one in equals(steps)}
    if cause not in known:
        raise _not_equal(cause, [*(step.effect.name for step in steps), *known])
    chosen = known[cause]
    fit = improved(
        rescaled(dataset, fit), contexts(dataset, plain), replaced(fit.model, chosen), ROUNDS
    )
    return [
        Step(
            chosen.effect,
            (step.effect.name, *(name for name in step.rivals if name != cause)),
            step.ranking,
            fit,
        )
        if step.effect.name == chosen.replaces
        else step
        for step in steps
    ], fit


def _not_equal(cause: str, names: Sequence[str]) -> CauseError:
    if not names:
        return CauseError(f"{cause}: no cause was found in these data; leave it out")
    listed = ", ".join(dict.fromkeys(names))
    return CauseError(f"{cause}: does not explain these data equally well; choose from {listed}")


def equals(steps: Sequence[Step]) -> list[Equal]:
    """Return the effects that explain as much as the causes, each in its best variant."""
    causes = [step.effect.name for step in steps]
    found = []
    for step in steps:
        for name in step.rivals:
            if name not in causes:
                ranked = next(one for one in step.ranking if one.name == name)
                found.append(Equal(step.effect.name, ranked.effect, ranked.values))
    return found
