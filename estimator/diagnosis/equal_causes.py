"""Causes that explain the data equally well, and the choice among them."""

from collections.abc import Sequence

from estimator.diagnosis.dataset import Dataset, Fit, build_contexts, rescale_residuals
from estimator.diagnosis.fit import fit_model
from estimator.diagnosis.outcome import CauseStep
from estimator.diagnosis.rivals import ROUNDS, CauseError, EquivalentCause, replace_cause


def choose_equivalent_cause(
    dataset: Dataset,
    plain: Fit,
    steps: list[CauseStep],
    fit: Fit,
    cause: str,
) -> tuple[list[CauseStep], Fit]:
    """Return the causes with one of equally good ones in the place of the first of them."""
    if cause in [step.effect.name for step in steps]:
        return steps, fit
    known = {one.effect.name: one for one in find_equivalent_causes(steps)}
    if cause not in known:
        raise _build_cause_error(cause, [*(step.effect.name for step in steps), *known])
    chosen = known[cause]
    fit = fit_model(
        rescale_residuals(dataset, fit),
        build_contexts(dataset, plain),
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
    found = []
    for step in steps:
        for name in step.rivals:
            if name not in causes:
                ranked = next(one for one in step.ranking if one.name == name)
                found.append(EquivalentCause(step.effect.name, ranked.effect, ranked.values))
    return found
