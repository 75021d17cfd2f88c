"""What `make docs` generates: pages of commands, config keys and messages, tables of effects.

A hook of mkdocs (`hooks` in mkdocs.yml); nothing is written beside the site.
"""

import argparse
import dataclasses
import inspect
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import get_args, get_type_hints

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from docs.messages_page import format_page
from estimator.effects import CATALOGUE, NAMES, Effect, Parameter
from slave.simulation.effects import EffectConfig
from teleop.cli.commands import COMMANDS, build_parser
from teleop.cli.config.reference import render_markdown

CATALOGUE_MARK = "<!-- catalogue of effects -->"
SIMULATED_MARK = "<!-- effects of the simulated rig -->"
_WIDTH = "92"  # columns of a help text

_TABLE_HEAD = (
    "name",
    "what goes on",
    "what it adds to the model",
    "parameters and ranges",
    "what to do",
)
_COMMANDS_PAGE = """\
# Commands

Generated from `teleop COMMAND --help`. `teleop` takes one command; its exit codes are those of the
[configuration](configuration.md#exit-codes).

| command | |
|---|---|
{table}

{sections}
"""


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages."""
    files.append(File.generated(config, "reference/messages.md", content=format_page()))
    files.append(File.generated(config, "reference/cli.md", content=format_commands()))
    keys = render_markdown("")
    files.append(File.generated(config, "reference/configuration-keys.md", content=keys))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Put the tables of effects in the places of their marks."""
    for mark, table in ((CATALOGUE_MARK, format_catalogue), (SIMULATED_MARK, format_effects)):
        if mark in markdown:
            markdown = markdown.replace(mark, table())
    return markdown


def format_catalogue() -> str:
    """Return the table: a row per name, with the differences of its variants."""
    rows = [_TABLE_HEAD, ("---",) * len(_TABLE_HEAD), *map(_format_row, NAMES)]
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


def format_effects() -> str:
    """Return the effects of the simulated rig as a table, by the declarations of their configs."""
    rows = ["| `type` | parameters and defaults | what happens |", "|---|---|---|"]
    for effect in get_args(EffectConfig):
        parameters = (
            f"`{item.name}` {item.default:g} {item.metadata['range'][2]}".rstrip()
            if "range" in item.metadata
            else f"`{item.name}`"
            for item in dataclasses.fields(effect)
            if item.name not in ("type", "joint", "start", "tendon")
        )
        alone = "" if getattr(effect, "adds_up", True) else " ¹"
        (what,) = (inspect.getdoc(effect) or "").splitlines()[:1]
        (name,) = get_args(get_type_hints(effect)["type"])
        rows.append(f"| `{name}`{alone} | {', '.join(parameters)} | {what.rstrip('.')} |")
    return "\n".join(rows)


def format_commands() -> str:
    """Return the page of all commands, each with its help text."""
    before, os.environ["COLUMNS"] = os.environ.get("COLUMNS"), _WIDTH
    try:
        helps = [(name, list(_list_helps(name))) for name in COMMANDS]
    finally:
        os.environ.pop("COLUMNS") if before is None else os.environ.update(COLUMNS=before)
    table = "\n".join(
        f"| [`teleop {name}`](#teleop-{name}) | {COMMANDS[name][1].replace('|', chr(92) + '|')} |"
        for name, _ in helps
    )
    sections = "\n\n".join(
        f"{'#' * level} teleop {title}\n\n```text\n{text.rstrip()}\n```"
        for _, parts in helps
        for level, title, text in parts
    )
    return _COMMANDS_PAGE.format(table=table, sections=sections)


def _list_helps(name: str) -> Iterator[tuple[int, str, str]]:
    """Yield level of the heading, words and help text of a command and of its actions."""
    parser = _find_subparsers(build_parser(name))[name]
    yield 2, name, parser.format_help()
    for action, sub in _find_subparsers(parser).items():
        yield 3, f"{name} {action}", sub.format_help()


def _find_subparsers(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    found = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    return dict(found[0].choices) if found else {}
