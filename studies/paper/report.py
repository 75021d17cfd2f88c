"""The experiment in words and numbers: Markdown tables."""

import math
from itertools import product

from estimator.report_table import Table
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
    collect_errors,
    compute_spread,
)

SIGNALS = ("force", "elongation")
ITEMS = ("largest", "average")
WORST = 3  # sheaths named


def build_phase_table(outcome: Outcome) -> Table:
    """Return the errors of one sheath on the paper's profile, phase by phase."""
    columns = [(signal, method) for signal in SIGNALS for method in METHODS]
    rows = [
        (phase, *(_format_errors(outcome, method, phase, signal) for signal, method in columns))
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


def build_spread_table(outcomes: list[Outcome]) -> Table:
    """Return how the errors of whole runs are spread over the sheaths."""
    rows = []
    for item, signal, motion, method in product(ITEMS, SIGNALS, MOTIONS, METHODS):
        found = _compute_spread(outcomes, method, motion, signal, item)
        shares = map(_format_percent, (found.median, found.ninetieth, found.largest))
        counts = f"{found.within} of {found.sheaths}", f"{100.0 * _get_target(signal, item):g}"
        rows.append((f"{item} of {signal}", motion, method, *shares, *counts))
    head = ("error", "motion", "method", "median", "90 %", "largest", "within", "asked")
    return Table(head, tuple(rows))


def list_worst_sheaths(outcomes: list[Outcome], method: str, seed: int) -> list[str]:
    """Return the sheaths that a method refused, and those on which its force was furthest off."""

    def error(outcome: Outcome) -> float:
        scores = outcome.results[method].scores
        return max(scores[motion][WHOLE].force.largest for motion in MOTIONS)

    used = sorted((o for o in outcomes if o.results[method].scores), key=error, reverse=True)
    refused = [o for o in outcomes if not o.results[method].scores]
    return [
        *(f"refused: seed {seed}, {o.specimen}: {o.results[method].refusal}" for o in refused),
        *(
            f"{_format_percent(error(o))} %: seed {seed}, {o.specimen}; "
            f"its K {o.results[method].K:.3f}"
            for o in used[:WORST]
        ),
    ]


def format_summary(outcomes: list[Outcome]) -> str:
    """Return in one line on how many sheaths ours is within what is asked, and what that is."""
    kept = sum(meets_targets(outcome) for outcome in outcomes)
    refused = sum(not outcome.results[OURS].scores for outcome in outcomes)
    asked = "; ".join(
        f"{signal}, largest {100.0 * largest:g} %, average {100.0 * average:g} %"
        for signal, (largest, average) in TARGETS.items()
    )
    return (
        f"Ours: {kept} of {len(outcomes)} sheaths within all that is asked, in both motions "
        f"({asked}); {refused} refused."
    )


def meets_targets(outcome: Outcome) -> bool:
    """Return whether ours was within every target on a sheath."""
    scores = outcome.results[OURS].scores
    return bool(scores) and all(
        getattr(getattr(scores[motion][WHOLE], signal), item) <= _get_target(signal, item)
        for motion, signal, item in product(MOTIONS, SIGNALS, ITEMS)
    )


def format_tables(shown: Outcome, outcomes: list[Outcome], seed: int) -> str:
    """Return all tables as Markdown."""
    parts = ["# The experiment of Phee et al. 2009, repeated", format_summary(outcomes)]
    parts += ["Errors in % of full scale, the largest true value of the run."]
    parts += [f"## A sheath as the paper's: {shown.specimen.describe()}", "Largest / average."]
    parts += [build_phase_table(shown).to_markdown()]
    parts += [f"## {len(outcomes)} random sheaths, seed {seed}"]
    parts += [build_spread_table(outcomes).to_markdown()]
    for method in METHODS:
        worst = "\n".join(f"- {line}" for line in list_worst_sheaths(outcomes, method, seed))
        parts += [f"### Worst of {method}, by the largest error of force", worst]
    return "\n\n".join(parts)


def _compute_spread(
    outcomes: list[Outcome], method: str, motion: str, signal: str, item: str
) -> Spread:
    return compute_spread(
        collect_errors(outcomes, method, motion, signal, item), _get_target(signal, item)
    )


def _get_target(signal: str, item: str) -> float:
    return TARGETS[signal][ITEMS.index(item)]


def _format_errors(outcome: Outcome, method: str, phase: str, signal: str) -> str:
    scores = outcome.results[method].scores
    if not scores:
        return "refused"
    found: Errors = getattr(scores[PROFILE][phase], signal)
    if math.isnan(found.largest):
        return "–"
    return f"{_format_percent(found.largest)} / {_format_percent(found.average)}"


def _format_percent(share: float) -> str:
    if math.isinf(share):
        return "refused"
    return f"{100.0 * share:.2f}" if share < 0.0995 else f"{100.0 * share:.0f}"
