"""The catalogue of effects as it stands in docs/diagnosis.md, whose last table it is.

python -m teleop.tools.diagnose.catalogue docs/diagnosis.md
"""

import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from estimator.effects import CATALOGUE, NAMES, Effect, Parameter

HEAD = ("name", "what goes on", "what it adds to the model", "parameters and ranges", "what to do")


def markdown() -> str:
    """Return the table: a row for each name, what its variants differ in one below the other."""
    rows = [HEAD, ("---",) * len(HEAD), *map(_row, NAMES)]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _row(name: str) -> tuple[str, ...]:
    variants = [effect for effect in CATALOGUE if effect.name == name]
    return (
        f"`{name}`",
        _cell(dict.fromkeys(effect.cause for effect in variants)),
        _cell(_by_variant(variants, lambda effect: effect.equation)),
        _cell(_by_variant(variants, lambda effect: ", ".join(map(_parameter, effect.parameters)))),
        _cell(dict.fromkeys(effect.advice for effect in variants)),
    )


def _by_variant(variants: Sequence[Effect], say: Callable[[Effect], str]) -> list[str]:
    """Return what the variants say; one that says something of its own by its name."""
    variants_by_text: dict[str, list[str]] = {}
    for effect in variants:
        variants_by_text.setdefault(say(effect), []).append(effect.where)
    own = len(variants_by_text) == len(variants) > 1
    return [f"{where[0]}: {text}" if own else text for text, where in variants_by_text.items()]


def _cell(lines: Iterable[str]) -> str:
    return "<br>".join(lines).replace("|", "\\|")


def _parameter(parameter: Parameter) -> str:
    unit = f" {parameter.unit}" if parameter.unit else ""
    return f"{parameter.name} {parameter.low:g} to {parameter.high:g}{unit}"


def renewed(page: str) -> str:
    """Return a page with the table at its end made anew."""
    return page[: page.index("| " + " | ".join(HEAD))] + markdown() + "\n"


if __name__ == "__main__":
    path = Path(sys.argv[1])
    path.write_text(renewed(path.read_text()))
