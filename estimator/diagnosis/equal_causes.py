"""Causes that explain the data equally well, and the choice among them."""

from collections.abc import Sequence

from estimator.diagnosis.dataset import Dataset, Fit, contexts, rescaled
from estimator.diagnosis.fit import improved
from estimator.diagnosis.outcome import Step
from estimator.diagnosis.rivals import ROUNDS, CauseError, Equal, replaced
from estimator.effects.effect import Effect


def with_cause(
    dataset: Dataset,
    plain: Fit,
    steps: list[Step],
    fit: Fit,
    usable: Sequence[Effect],
    cause: str,
) -> tuple[list[Step], Fit]:
    """Return the causes with one of equally good ones in the place of the first of them.

    Raises
    ------
    CauseError
        If `cause` is none of them; the message names them.
    """
    if cause in [step.effect.name for step in steps]:
        return steps, fit
    known = {one.name: one for one in equals(dataset, steps, usable)}
    if cause not in known:
        raise _not_equal(cause, [*(step.effect.name for step in steps), *known])
    chosen = known[cause]
    fit = improved(
        rescaled(dataset, fit), contexts(dataset, plain), replaced(fit.model, chosen), ROUNDS
    )
    return [
        Step(
            chosen.effect,
            (
                rival_name(step.effect, chosen.effect),
                *(name for name in step.rivals if name != cause),
            ),
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


def rival_name(rival: Effect, cause: Effect) -> str:
    """Return what a rival of a cause is called: with its variant if that is the difference."""
    return rival.label if rival.name == cause.name else rival.name


def equals(dataset: Dataset, steps: Sequence[Step], usable: Sequence[Effect]) -> list[Equal]:
    """Return the effects that explain as much as the causes, each in its best variant."""
    effects = {effect.label: effect for effect in usable}
    size = dataset.records[0].units.size
    causes = [step.effect.name for step in steps]
    found = []
    for step in steps:
        for name in step.rivals:
            ranked = next(one for one in step.ranking if name in (one.name, one.label))
            if name not in causes:
                effect = effects[ranked.label]
                values = tuple(ranked.values[p.name] / size(p.unit) for p in effect.parameters)
                found.append(Equal(name, step.effect.name, effect, values))
    return found
