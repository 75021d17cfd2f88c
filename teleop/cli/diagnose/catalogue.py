"""Generate the catalogue of effects as a table.

`python -m teleop.cli.diagnose.catalogue` prints it, and `make docs` puts it into diagnose.md.
"""

from collections.abc import Callable, Iterable, Sequence

from estimator.effects import CATALOGUE, NAMES, Effect, Parameter

TABLE_HEAD = (
    "name",
    "what goes on",
    "what it adds to the model",
    "parameters and ranges",
    "what to do",
)


def format_catalogue() -> str:
    """Return the table: a row per name, with the differences of its variants."""
    rows = [TABLE_HEAD, ("---",) * len(TABLE_HEAD), *map(_format_row, NAMES)]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _format_row(name: str) -> tuple[str, ...]:
    variants = [effect for effect in CATALOGUE if effect.name == name]
    return (
        f"`{name}`",
        _format_cell(dict.fromkeys(effect.cause for effect in variants)),
        _format_cell(_merge_variants(variants, lambda effect: effect.equation)),
        _format_cell(
            _merge_variants(
                variants, lambda effect: ", ".join(map(_format_parameter, effect.parameters))
            )
        ),
        _format_cell(dict.fromkeys(effect.advice for effect in variants)),
    )


def _merge_variants(variants: Sequence[Effect], say: Callable[[Effect], str]) -> list[str]:
    """Return the texts of the variants, with variant names if they differ."""
    variants_by_text: dict[str, list[str]] = {}
    for effect in variants:
        variants_by_text.setdefault(say(effect), []).append(effect.where)
    is_distinct = len(variants_by_text) == len(variants) > 1
    return [
        f"{where[0]}: {text}" if is_distinct else text for text, where in variants_by_text.items()
    ]


def _format_cell(lines: Iterable[str]) -> str:
    return "<br>".join(lines).replace("|", "\\|")


def _format_parameter(parameter: Parameter) -> str:
    unit = f" {parameter.unit}" if parameter.unit else ""
    return f"{parameter.name} {parameter.low:g} to {parameter.high:g}{unit}"


if __name__ == "__main__":
    print(format_catalogue())
