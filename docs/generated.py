"""What `make docs` generates: the pages of commands, config keys and messages, and the catalogue of effects.

A hook of mkdocs (`hooks` in mkdocs.yml); nothing is written beside the site.
"""

import argparse
import os
from collections.abc import Iterator

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from teleop.cli.commands import COMMANDS, build_parser
from teleop.cli.config.reference import render_config_reference
from teleop.cli.diagnose.catalogue import format_catalogue
from teleop.messages.page import format_page

CATALOGUE_MARK = "<!-- catalogue of effects -->"
_WIDTH = "92"  # columns of a help text

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
    keys = render_config_reference()
    files.append(File.generated(config, "reference/configuration-keys.md", content=keys))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Put the catalogue of effects in the place of its mark."""
    return markdown.replace(CATALOGUE_MARK, format_catalogue())


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
