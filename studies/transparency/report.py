"""The study in numbers: Markdown tables."""

import math
from collections.abc import Callable, Iterable

import numpy as np

from estimator.report_table import Table
from studies.transparency import hybrid
from studies.transparency.study import HANDS, Case, Study, Walls

PARAMETERS = ("h11", "h12", "h21", "h22")
TRUSTED = 0.95  # coherence below which a line is no number of a linear system
RIPPLE = 0.05  # [N] of a force on the hand that has not come to rest
SHOWN = 1000.0  # [N/m] of the spring that the summary tells of


def format_milliseconds(round_trip: float) -> str:
    """Return a delay for people."""
    return f"{1e3 * round_trip:g} ms"


def find_worst_walls(case: Case, damping: float) -> Walls:
    """Return what is stable with every hand, and the worst buzz of it."""
    walls = [w for (_, b), w in case.walls.items() if b == damping]
    buzz = [w.buzz for w in walls if math.isfinite(w.buzz)]
    return Walls(min(w.width for w in walls), max(buzz, default=math.nan))


def format_width(study: Study, walls: Walls) -> str:
    """Return a Z-width [N/m] for people."""
    if walls.width.stable == 0.0:
        return f"< {study.lowest:.0f}"
    return f"{'≥ ' if math.isinf(walls.width.unstable) else ''}{_round_off(walls.width.stable)}"


def format_tables(study: Study, cases: list[Case]) -> str:
    """Return all tables as Markdown; studies/results/coupling.md says how each is measured."""
    tables = {
        "In short": build_summary_table(study, cases),
        "Rendered against true stiffness": build_stiffness_table(study, cases),
        "Z-width with each hand": build_width_table(study, cases),
        "Linearity of the hybrid parameters": build_quality_table(cases),
    }
    return "\n\n".join(f"## {title}\n\n{table.to_markdown()}" for title, table in tables.items())


def _build_rows(
    cases: list[Case], describe: Callable[[Case], Iterable[str]]
) -> tuple[tuple[str, ...], ...]:
    """Return a row for each coupling and delay, with what `describe` says of it."""
    return tuple((c.coupling, format_milliseconds(c.round_trip), *describe(c)) for c in cases)


def build_summary_table(study: Study, cases: list[Case]) -> Table:
    """Return what each coupling is at each delay, in a line."""
    shown = min(study.stiffnesses, key=lambda k: abs(math.log(k / SHOWN)))
    head = (
        "coupling",
        "round trip",
        f"felt of {shown:g} N/m",
        *(f"Z-width at {b:g} N s/m [N/m]" for b in study.dampings),
        "buzz [N]",
        f"drag at {study.excitation.frequency[0]:g} Hz [N s/m]",
        "Llewellyn",
    )

    def describe(case: Case) -> Iterable[str]:
        pressed = next(p for p in case.pressed if p.true == shown)
        walls = [find_worst_walls(case, b) for b in study.dampings]
        yield f"{100.0 * pressed.rendered:.0f} %{_format_ripple(pressed.ripple)}"
        yield from (format_width(study, w) for w in walls)
        yield _format_number(
            max((w.buzz for w in walls if math.isfinite(w.buzz)), default=math.nan)
        )
        yield _format_drag(case)
        yield _format_criterion(study, case)

    return Table(head, _build_rows(cases, describe))


def build_stiffness_table(study: Study, cases: list[Case]) -> Table:
    """Return the stiffness felt at the hand [N/m], and in % of what the scales make of it."""
    head = ("coupling", "round trip", *(f"{k:g} N/m" for k in study.stiffnesses))

    def describe(case: Case) -> Iterable[str]:
        for p in case.pressed:
            yield f"{_round_off(p.felt)} ({100.0 * p.rendered:.0f} %{_format_ripple(p.ripple)})"

    return Table(head, _build_rows(cases, describe))


def build_width_table(study: Study, cases: list[Case]) -> Table:
    """Return the Z-width with each hand, and how the force trembles there."""
    columns = [(hand, b) for hand in HANDS for b in study.dampings]
    titles = (f"{hand}, {b:g} N s/m: [N/m], buzz [N]" for hand, b in columns)

    def describe(case: Case) -> Iterable[str]:
        return (
            f"{format_width(study, case.walls[c])}, {_format_number(case.walls[c].buzz)}"
            for c in columns
        )

    return Table(("coupling", "round trip", *titles), _build_rows(cases, describe))


def build_quality_table(cases: list[Case]) -> Table:
    """Return how linear the answers were: worst coherence, distortion."""
    head = ("coupling", "round trip", *(f"{p}: coherence, distortion" for p in PARAMETERS))

    def describe(case: Case) -> Iterable[str]:
        for response in (getattr(case.hybrid, p) for p in PARAMETERS):
            yield f"{response.coherence.min():.2f}, {100.0 * response.distortion:.1f} %"

    return Table(head, _build_rows(cases, describe))


def _format_criterion(study: Study, case: Case) -> str:
    if not study.is_linear(case.coupling, case.round_trip):
        return "does not apply"
    found = hybrid.compute_margin(case.hybrid)
    if found.stable.all():
        return f"stable, η ≥ {found.eta.min():.2f}"
    at = case.hybrid.frequency[int(np.argmin(found.eta))]
    lines = f"{np.count_nonzero(~found.stable)} of {len(found.eta)}"
    return f"fails at {lines} lines, η {found.eta.min():.2f} at {at:g} Hz"


def _format_drag(case: Case) -> str:
    value, coherence = case.hybrid.h11.value[0], case.hybrid.h11.coherence[0]
    return f"{value.real:.1f}" + ("" if coherence >= TRUSTED else f" (coherence {coherence:.2f})")


def _format_ripple(ripple: float) -> str:
    return f", ripple {ripple:.2f} N" if ripple > RIPPLE else ""


def _round_off(value: float) -> str:
    return f"{float(f'{value:.2g}'):.0f}" if abs(value) < 1e6 else f"{value:.2g}"


def _format_number(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "–"
