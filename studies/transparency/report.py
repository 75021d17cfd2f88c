"""The study in numbers: Markdown tables for people, a tree for programs."""

import math
from typing import Any

import numpy as np

from estimator.text_table import Table
from studies.transparency import hybrid, stiffness, zwidth
from studies.transparency.hybrid import Response
from studies.transparency.study import CONTACT, HANDS, LOAD, PRETENSION, SPRING, Case, Study, Walls
from teleop.cli.html_page import to_json_values

PARAMETERS = ("h11", "h12", "h21", "h22")
TRUSTED = 0.95  # coherence below which a line is no number of a linear system
RIPPLE = 0.05  # [N] of a force on the hand that has not come to rest
SHOWN = 1000.0  # [N/m] of the spring that the summary tells of


def milliseconds(round_trip: float) -> str:
    """Return a delay for people."""
    return f"{1e3 * round_trip:g} ms"


def worst(case: Case, damping: float) -> Walls:
    """Return what is stable with every hand, and the worst buzz of it."""
    walls = [w for (_, b), w in case.walls.items() if b == damping]
    buzz = [w.buzz for w in walls if math.isfinite(w.buzz)]
    return Walls(min(w.width for w in walls), max(buzz, default=math.nan))


def width(study: Study, walls: Walls) -> str:
    """Return a Z-width [N/m] for people."""
    if walls.width.stable == 0.0:
        return f"< {study.lowest:.0f}"
    return f"{'≥ ' if math.isinf(walls.width.unstable) else ''}{_round(walls.width.stable)}"


def text(study: Study, cases: list[Case]) -> str:
    """Return all tables as Markdown; studies/results/coupling.md says how each is measured."""
    tables = {
        "In short": summary(study, cases),
        "Rendered against true stiffness": stiffnesses(study, cases),
        "Z-width with each hand": widths(study, cases),
        "Linearity of the hybrid parameters": quality(cases),
    }
    return "\n\n".join(f"## {title}\n\n{table.to_markdown()}" for title, table in tables.items())


def summary(study: Study, cases: list[Case]) -> Table:
    """Return what each coupling is at each delay, in a line."""
    shown = min(study.stiffnesses, key=lambda k: abs(math.log(k / SHOWN)))
    head = (
        "coupling",
        "round trip",
        f"felt of {shown:g} N/m",
        *(f"Z-width at {b:g} N s/m [N/m]" for b in study.dampings),
        "buzz [N]",
        f"drag at {_lowest(study):g} Hz [N s/m]",
        "Llewellyn",
    )
    rows = []
    for case in cases:
        pressed = next(p for p in case.pressed if p.true == shown)
        walls = [worst(case, b) for b in study.dampings]
        rows.append(
            (
                case.coupling,
                milliseconds(case.round_trip),
                f"{100.0 * pressed.rendered:.0f} %{_rippled(pressed.ripple)}",
                *(width(study, w) for w in walls),
                _number(max((w.buzz for w in walls if math.isfinite(w.buzz)), default=math.nan)),
                _drag(case),
                _criterion(study, case),
            )
        )
    return Table(head, tuple(rows))


def stiffnesses(study: Study, cases: list[Case]) -> Table:
    """Return the stiffness felt at the hand [N/m], and in % of what the scales make of it."""
    head = ("coupling", "round trip", *(f"{k:g} N/m" for k in study.stiffnesses))
    rows = [
        (
            case.coupling,
            milliseconds(case.round_trip),
            *(
                f"{_round(p.felt)} ({100.0 * p.rendered:.0f} %{_rippled(p.ripple)})"
                for p in case.pressed
            ),
        )
        for case in cases
    ]
    return Table(head, tuple(rows))


def widths(study: Study, cases: list[Case]) -> Table:
    """Return the Z-width with each hand, and how the force trembles there."""
    columns = [(hand, b) for hand in HANDS for b in study.dampings]
    head = (
        "coupling",
        "round trip",
        *(f"{hand}, {b:g} N s/m: [N/m], buzz [N]" for hand, b in columns),
    )
    rows = [
        (
            case.coupling,
            milliseconds(case.round_trip),
            *(f"{width(study, case.walls[c])}, {_number(case.walls[c].buzz)}" for c in columns),
        )
        for case in cases
    ]
    return Table(head, tuple(rows))


def quality(cases: list[Case]) -> Table:
    """Return how linear the answers were: worst coherence, distortion."""
    head = ("coupling", "round trip", *(f"{p}: coherence, distortion" for p in PARAMETERS))
    rows = [
        (
            case.coupling,
            milliseconds(case.round_trip),
            *(_linear(getattr(case.hybrid, p)) for p in PARAMETERS),
        )
        for case in cases
    ]
    return Table(head, tuple(rows))


def tree(study: Study, cases: list[Case]) -> dict[str, Any]:
    """Return all of it for a JSON file; SI units, null where there is no number."""
    settings = {
        **to_json_values(study),
        "hands": HANDS,
        "couplings_set": {name: study.coupling(name) for name in study.couplings},
        "press": {"force": stiffness.FORCE, "steps": stiffness.STEPS},
        "stable": {
            "swing": zwidth.SWING,
            "span": zwidth.SPAN,
            "fades": zwidth.FADES,
            "energy": zwidth.ENERGY,
        },
        "rig": {"contact": CONTACT, "pretension": PRETENSION, "spring": SPRING, "load": LOAD},
        "trusted_coherence": TRUSTED,
    }
    values: dict[str, Any] = to_json_values(
        {"settings": settings, "cases": [_case_tree(study, case) for case in cases]}
    )
    return values


def _case_tree(study: Study, case: Case) -> dict[str, Any]:
    responses: dict[str, Response] = {name: getattr(case.hybrid, name) for name in PARAMETERS}
    return {
        "coupling": case.coupling,
        "round_trip": case.round_trip,
        "stiffness": case.pressed,
        "z_width": [
            {"hand": hand, "damping": damping, **walls.width._asdict(), "buzz": walls.buzz}
            for (hand, damping), walls in case.walls.items()
        ],
        "frequency": case.hybrid.frequency,
        "llewellyn": (
            hybrid.margin(case.hybrid) if study.linear(case.coupling, case.round_trip) else None
        ),
        **{
            name: {
                "real": response.value.real,
                "imag": response.value.imag,
                "coherence": response.coherence,
                "distortion": response.distortion,
            }
            for name, response in responses.items()
        },
    }


def _criterion(study: Study, case: Case) -> str:
    if not study.linear(case.coupling, case.round_trip):
        return "does not apply"
    found = hybrid.margin(case.hybrid)
    if found.stable.all():
        return f"stable, η ≥ {found.eta.min():.2f}"
    at = case.hybrid.frequency[int(np.argmin(found.eta))]
    lines = f"{np.count_nonzero(~found.stable)} of {len(found.eta)}"
    return f"fails at {lines} lines, η {found.eta.min():.2f} at {at:g} Hz"


def _drag(case: Case) -> str:
    value, coherence = case.hybrid.h11.value[0], case.hybrid.h11.coherence[0]
    return f"{value.real:.1f}" + ("" if coherence >= TRUSTED else f" (coherence {coherence:.2f})")


def _lowest(study: Study) -> float:
    return float(study.excitation.frequency[0])


def _linear(response: Response) -> str:
    return f"{response.coherence.min():.2f}, {100.0 * response.distortion:.1f} %"


def _rippled(ripple: float) -> str:
    return f", ripple {ripple:.2f} N" if ripple > RIPPLE else ""


def _round(value: float) -> str:
    return f"{float(f'{value:.2g}'):.0f}" if abs(value) < 1e6 else f"{value:.2g}"


def _number(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "–"
