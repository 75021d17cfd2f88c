"""The experiment in words and numbers: Markdown tables for people, a tree for programs."""

import math
from typing import Any

from estimator.text_table import Table
from studies.paper.methods import METHODS, OURS, PAPER
from studies.paper.study import (
    MOTIONS,
    PHASES,
    PROFILE,
    PUBLISHED,
    TARGETS,
    WHOLE,
    Errors,
    Outcome,
    Spread,
    spread,
    values,
)
from teleop.cli.html_page import to_json_values

SIGNALS = ("force", "elongation")
ITEMS = ("largest", "average")
WORST = 3  # sheaths named


def by_phase(outcome: Outcome) -> Table:
    """Return the errors of one sheath on the paper's profile, phase by phase."""
    columns = [(signal, method) for signal in SIGNALS for method in METHODS]
    rows = [
        (phase, *(_pair(outcome, method, phase, signal) for signal, method in columns))
        for phase in (*PHASES, WHOLE)
    ]
    published = (
        f"{100 * largest:.0f} / below {100 * average:.0f}"
        for largest, average in (PUBLISHED[signal] for signal in SIGNALS)
    )
    rows.append(
        ("published", *(next(published) if method == PAPER else "" for _, method in columns))
    )
    return Table(("phase", *(f"{signal}, {method}" for signal, method in columns)), tuple(rows))


def over_sheaths(outcomes: list[Outcome]) -> Table:
    """Return how the errors of whole runs are spread over the sheaths."""
    rows = []
    for item in ITEMS:
        for signal in SIGNALS:
            for motion in MOTIONS:
                for method in METHODS:
                    found = _spread(outcomes, method, motion, signal, item)
                    numbers = (found.median, found.ninetieth, found.largest)
                    rows.append(
                        (
                            f"{item} of {signal}",
                            motion,
                            method,
                            *(_percent(number) for number in numbers),
                            f"{found.within} of {found.sheaths}",
                            f"{100.0 * _target(signal, item):g}",
                        )
                    )
    head = ("error", "motion", "method", "median", "90 %", "largest", "within", "asked")
    return Table(head, tuple(rows))


def worst(outcomes: list[Outcome], method: str, seed: int) -> list[str]:
    """Return the sheaths that a method refused, and those on which its force was furthest off."""

    def error(outcome: Outcome) -> float:
        scores = outcome.results[method].scores
        return max(scores[motion][WHOLE].force.largest for motion in MOTIONS)

    used = sorted((o for o in outcomes if o.results[method].scores), key=error, reverse=True)
    refused = [o for o in outcomes if not o.results[method].scores]
    return [
        *(f"refused: seed {seed}, {o.specimen}: {o.results[method].refusal}" for o in refused),
        *(
            f"{_percent(error(o))} %: seed {seed}, {o.specimen}; its K {o.results[method].K:.3f}"
            for o in used[:WORST]
        ),
    ]


def summary(outcomes: list[Outcome]) -> str:
    """Return in one line on how many sheaths ours is within what is asked, and what that is."""
    kept = sum(meets(outcome) for outcome in outcomes)
    refused = sum(not outcome.results[OURS].scores for outcome in outcomes)
    asked = "; ".join(
        f"{signal}, largest {100.0 * largest:g} %, average {100.0 * average:g} %"
        for signal, (largest, average) in TARGETS.items()
    )
    return (
        f"Ours: {kept} of {len(outcomes)} sheaths within all that is asked, in both motions "
        f"({asked}); {refused} refused."
    )


def meets(outcome: Outcome) -> bool:
    """Return whether ours was within every target on a sheath."""
    scores = outcome.results[OURS].scores
    return bool(scores) and all(
        getattr(getattr(scores[motion][WHOLE], signal), item) <= _target(signal, item)
        for motion in MOTIONS
        for signal in SIGNALS
        for item in ITEMS
    )


def tree(shown: Outcome, outcomes: list[Outcome], seed: int) -> dict[str, Any]:
    """Return all of it for a JSON file; errors in shares of full scale."""
    values: dict[str, Any] = to_json_values(
        {
            "seed": seed,
            "published": PUBLISHED,
            "targets": TARGETS,
            "shown": _outcome_tree(shown),
            "sheaths": [_outcome_tree(outcome) for outcome in outcomes],
            "spread": {
                motion: {
                    method: {
                        f"{item} {signal}": _spread(outcomes, method, motion, signal, item)
                        for signal in SIGNALS
                        for item in ITEMS
                    }
                    for method in METHODS
                }
                for motion in MOTIONS
            },
            "within_all_targets": sum(meets(outcome) for outcome in outcomes),
        }
    )
    return values


def _outcome_tree(outcome: Outcome) -> dict[str, Any]:
    specimen = outcome.specimen
    return {
        "number": specimen.number,
        "kind": specimen.kind,
        "K": specimen.K,
        "unevenness": outcome.unevenness,
        "friction": specimen.sheath.friction,
        "axial_stiffness_N": specimen.sheath.axial_stiffness,
        "tension_noise_N": specimen.tension_noise,
        "sections": [
            {"length_m": s.length, "radius_m": s.radius} for s in specimen.sheath.sections
        ],
        "methods": {
            method: {"K": result.K, "refusal": result.refusal or None, "errors": result.scores}
            for method, result in outcome.results.items()
        },
    }


def _spread(outcomes: list[Outcome], method: str, motion: str, signal: str, item: str) -> Spread:
    return spread(values(outcomes, method, motion, signal, item), _target(signal, item))


def _target(signal: str, item: str) -> float:
    return TARGETS[signal][ITEMS.index(item)]


def _pair(outcome: Outcome, method: str, phase: str, signal: str) -> str:
    scores = outcome.results[method].scores
    if not scores:
        return "refused"
    found: Errors = getattr(scores[PROFILE][phase], signal)
    return (
        "–"
        if math.isnan(found.largest)
        else (f"{_percent(found.largest)} / {_percent(found.average)}")
    )


def _percent(share: float) -> str:
    if math.isinf(share):
        return "refused"
    return f"{100.0 * share:.2f}" if share < 0.0995 else f"{100.0 * share:.0f}"
