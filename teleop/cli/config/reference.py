"""The page of all keys of a config, generated from the dataclasses.

`teleop config reference --format md` prints it, and `make docs` puts it into the site.
"""

import dataclasses
import re
import shutil
import textwrap
from collections.abc import Iterator
from functools import cache

from teleop.cli.config.keys import (
    REQUIRED,
    Config,
    Key,
    describe_keys,
    find_tag,
    list_tags,
    read_summary,
)
from teleop.cli.config.show import format_value
from teleop.config.extensions import Extension, ExtensionError, resolve_class
from teleop.config.suggestions import suggest_spelling
from teleop.errors import UsageError

_INTRODUCTION = """\
# Keys of the configuration

Generated from the config dataclasses by `teleop config reference --format md`. A key in brackets,
`joints[]`, is a list; `--set slave.rig.joints.0.body.mass=0.1` names an item by its place, from 0.
Where a section has several kinds, its key `type` says which. `teleop config show FILE` prints the
values of a config, and where each comes from.
"""

_WIDTH = (60, 100)  # least and largest, of text [characters]


@dataclasses.dataclass(frozen=True)
class Section:
    """A section of a config file: of one kind, where there are several."""

    path: str  # dotted; a list has [] behind its key
    tags: tuple[str, ...]  # kinds of this section and those above it, where there are several
    config: Config
    same_as: "Section | None" = None  # described there
    problem: str = ""  # an installed extension that cannot be imported: the reason

    @property
    def title(self) -> str:
        """Its place, and the kinds on the way."""
        kinds = f" ({', '.join(self.tags)})" if self.tags else ""
        return f"{self.path or 'top level'}{kinds}"

    @property
    def anchor(self) -> str:
        """Its name in links."""
        return re.sub(r"[^a-z0-9]+", "-", self.title.lower()).strip("-")


@cache
def list_sections() -> tuple[Section, ...]:
    """Return all sections of a session's config, each before those inside it."""
    from teleop.launch.config import SessionConfig

    found: dict[Config, Section] = {}
    return tuple(_walk(Section("", (), SessionConfig), found))


def _walk(section: Section, found: dict[Config, Section]) -> Iterator[Section]:
    known = found.setdefault(section.config, section)
    if known is not section or section.problem:
        yield dataclasses.replace(section, same_as=None if section.problem else known)
        return
    yield section
    for key in describe_keys(section.config):
        for inner in list_inner_sections(section, key):
            yield from _walk(inner, found)


def list_inner_sections(section: Section, key: Key) -> Iterator[Section]:
    """Yield the sections that a key of a section may hold: one, or one of each kind."""
    path = f"{section.path}.{key.name}".lstrip(".") + "[]" * key.is_list
    for kind in key.kinds:
        is_extension = issubclass(kind, Extension)
        for tag in list_tags([kind]) if is_extension else [find_tag(kind)]:
            tags, problem, config = (*section.tags, *[tag] * (tag != "")), "", kind
            if is_extension:
                try:
                    config = resolve_class(tag, kind)
                except ExtensionError as error:
                    problem = str(error)
            yield Section(path, tags, config, problem=problem)


def select_sections(section: str) -> list[Section]:
    """Return the sections at or below a dotted key, in which places of lists may be left out."""
    wanted = re.sub(r"\[\]|\.\d+(?=\.|$)", "", section)
    paths = {each: each.path.replace("[]", "") for each in list_sections()}
    selected = [each for each, path in paths.items() if f"{path}.".startswith(f"{wanted}.")]
    if wanted and not selected:
        hint = suggest_spelling(wanted, dict.fromkeys(paths.values()))
        raise UsageError(f"--section {section}: there is no such section{hint}")
    return selected if wanted else list(list_sections())


# --- as Markdown


def render_markdown(section: str) -> str:
    """Return the keys of a section and those inside it, of all without one, as Markdown."""
    parts = [] if section else [_INTRODUCTION]
    for each in select_sections(section):
        if each.same_as is None:
            kinds = ", ".join(f"`{tag}`" for tag in each.tags)
            title = f"`{each.path}`{f' ({kinds})' * bool(kinds)}" if each.path else each.title
            parts.append(f"## {title} {{#{each.anchor}}}\n")
            parts.append(f"{_escape(each.problem or read_summary(each.config))}.\n")
            parts += [] if each.problem else [_format_table(each)]
    return "\n".join(parts)


def _format_table(section: Section) -> str:
    anchors = {each.title: (each.same_as or each).anchor for each in list_sections()}
    rows = ["| key | type | default | unit | meaning | allowed |", "|---|---|---|---|---|---|"]
    for key in describe_keys(section.config):
        links = [
            f"[{f'`{inner.tags[-1]}`' if len(key.kinds) > 1 else 'keys'}](#{anchors[inner.title]})"
            for inner in list_inner_sections(section, key)
        ]
        default = format_default(key)
        cells = (
            f"`{key.name}`",
            key.type,
            f"`{default}`" if default else "required" if key.default is REQUIRED else "",
            key.unit,
            _escape(key.meaning),
            ", ".join(links) or _escape(key.allowed),
        )
        rows.append("| " + " | ".join(cells) + " |")
    return "\n".join(rows) + "\n"


def format_default(key: Key) -> str:
    """Return the default of a key as YAML, empty if it is required or a section with keys."""
    default = key.default
    if default is REQUIRED:
        return ""
    if dataclasses.is_dataclass(default):
        return find_tag(type(default))
    if isinstance(default, tuple) and default and dataclasses.is_dataclass(default[0]):
        return f"{len(default)} item{'s' * (len(default) > 1)}"
    return format_value(default)


def _escape(text: str) -> str:
    """Return text for a cell of a table: `|`, `<` and emphasis mean themselves outside of code."""
    parts = re.split(r"(`[^`]*`)", text)
    parts[::2] = [re.sub(r"([*_<\[\]])", r"\\\1", part) for part in parts[::2]]
    return "".join(parts).replace("|", "\\|")


# --- as text for a terminal


def render_text(section: str) -> str:
    """Return the keys of a section and those inside it, of all without one, as text."""
    width = min(max(shutil.get_terminal_size().columns, _WIDTH[0]), _WIDTH[1])
    lines = []
    for each in select_sections(section):
        if each.problem:
            lines += [f"{each.title}: {each.problem}", ""]
        elif each.same_as is not None:
            lines += [f"{each.title}: as {each.same_as.title}", ""]
        else:
            lines += textwrap.wrap(f"{each.title}: {read_summary(each.config)}", width)
            for key in describe_keys(each.config):
                lines += _format_key(key, width)
            lines.append("")
    return "\n".join(lines)


def _format_key(key: Key, width: int) -> Iterator[str]:
    """Yield the lines of a key: type and default, meaning, what is allowed."""
    default = format_default(key)
    given = f", default {default} {key.unit}".rstrip() if default else ""
    given = ", required" if key.default is REQUIRED else given
    tags = list_tags(key.kinds) if len(key.kinds) > 1 else []
    allowed = f"one of {', '.join(tags)}" if tags else key.allowed
    yield f"  {key.name}: {key.type}{given}"
    text = f"{key.meaning.rstrip('.')}. Allowed: {allowed}" if allowed else key.meaning
    yield from textwrap.wrap(text, width, initial_indent=" " * 6, subsequent_indent=" " * 6)
