"""A resolved config: each value, where it comes from and what it may be."""

import dataclasses
import json
import math
import re
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from teleop.cli.config.keys import Config, Key, describe_keys, list_tags
from teleop.config import strict_yaml
from teleop.config.extensions import Extension
from teleop.config.loading import ConfigDocument, as_tree
from teleop.config.overrides import Keys, find_override
from teleop.config.suggestions import suggest_spelling
from teleop.errors import UsageError

_PLAIN_TEXT = re.compile(r"[A-Za-z_./~][\w./~-]*")
COMMENT_COLUMN_MAX = 52


class ConfigValue(NamedTuple):
    """One value of a resolved config."""

    keys: Keys  # from the top; places in lists are counted from 0
    value: Any
    key: Key
    source: str  # FILE:LINE, --set KEY, or default

    def as_json(self) -> dict[str, Any]:
        """Return it as plain data; infinity is text, as a config accepts it."""
        tree = as_tree(self.value)
        return {
            "key": ".".join(self.keys),
            "value": _to_finite(tree),
            "source": self.source,
            "type": self.key.type,
            "unit": self.key.unit,
            "meaning": self.key.meaning,
            "allowed": self.key.allowed,
        }


def list_values(document: ConfigDocument, config: Any) -> Iterator[ConfigValue]:
    """Yield the values of a config that `document` was built into, in the order of the fields."""
    sources = _SourceFinder(document)

    def walk(section: Any, keys: Keys, kinds: tuple[Config, ...]) -> Iterator[ConfigValue]:
        extension = section.type if isinstance(section, Extension) else ""
        for key in describe_keys(type(section)):
            value, inner = getattr(section, key.name), (*keys, key.name)
            if dataclasses.is_dataclass(value):
                yield from walk(value, inner, key.kinds)
            elif isinstance(value, tuple) and value and dataclasses.is_dataclass(value[0]):
                for number, item in enumerate(value):
                    yield from walk(item, (*inner, str(number)), key.kinds)
            else:
                if key.name == "type":
                    allowed = f"one of {', '.join(list_tags(kinds))}"
                    key = dataclasses.replace(key, allowed=allowed)  # noqa: PLW2901
                yield ConfigValue(inner, value, key, sources.find(inner, extension))

    yield from walk(config, (), ())


def select_section(values: Sequence[ConfigValue], section: str) -> list[ConfigValue]:
    """Return the values at or below a dotted key; `UsageError` if there are none."""
    wanted = tuple(section.split("."))
    selected = [value for value in values if value.keys[: len(wanted)] == wanted]
    if selected:
        return selected
    depth = max(n for v in values for n in range(len(wanted)) if v.keys[:n] == wanted[:n])
    near = wanted[:depth]
    names = dict.fromkeys(
        v.keys[depth] for v in values if v.keys[:depth] == near and len(v.keys) > depth
    )
    if not names:
        raise UsageError(f"--section {section}: {'.'.join(near)} is a value, it has no keys")
    hint = suggest_spelling(wanted[depth], names)
    raise UsageError(
        f"--section {section}: there is no {wanted[depth]!r}{hint} (allowed: {', '.join(names)})"
    )


class _SourceFinder:
    """Finds where the values of a document come from."""

    def __init__(self, document: ConfigDocument) -> None:
        self._document = document
        self._lines = strict_yaml.find_lines(document.text)
        self._file = "" if document.path is None else document.path.name

    def find(self, keys: Keys, extension: str) -> str:
        """Return the source of the value at `keys`, in a section of an `extension` or of ours."""
        if not _is_stated(self._document.tree, keys):
            return f"default of {extension}" if extension else "default"
        override = find_override(self._document.overrides, keys)
        if override is not None:
            return f"--set {'.'.join(override.keys)}"
        override = find_override(self._document.recorded, keys)
        if override is not None:
            return f"{self._file}: --set {'.'.join(override.keys)}"
        line = self._lines.get(keys)
        return f"{self._file}:{line}" if line is not None else self._file


def _is_stated(tree: Any, keys: Keys) -> bool:
    """Return whether a file or an override has a value at `keys`."""
    for key in keys:
        if isinstance(tree, dict) and key in tree:
            tree = tree[key]
        elif isinstance(tree, list) and key.isdecimal() and int(key) < len(tree):
            tree = tree[int(key)]
        else:
            return False
    return True


# --- as text


def format_value(value: Any) -> str:
    """Return a plain value, or a list of them, as strict YAML on one line."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(format_value, value))}]"
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    if isinstance(value, float) and math.isinf(value):
        return ".inf" if value > 0.0 else "-.inf"
    if isinstance(value, int | float):
        return repr(value)
    text = str(value)
    is_plain = _PLAIN_TEXT.fullmatch(text) and strict_yaml.parse(text, "") == text
    return text if is_plain else json.dumps(text)


def format_values(values: Sequence[ConfigValue]) -> str:
    """Return values as the YAML of a config file, with source and allowed values as comments."""
    rows: list[tuple[str, str]] = []
    before: Keys = ()
    for each in values:
        shared = 0
        while shared < len(before) and before[shared] == each.keys[shared]:
            shared += 1
        for depth in range(shared, len(each.keys) - 1):  # the sections above it that are new
            if not each.keys[depth].isdecimal():
                lead = _format_lead(each.keys[: depth + 1], shared)
                rows.append((f"{lead}{each.keys[depth]}:", ""))
        lead = _format_lead(each.keys, shared)
        rows.append((f"{lead}{each.keys[-1]}: {format_value(each.value)}", _format_comment(each)))
        before = each.keys[:-1]
    width = min(max(len(text) for text, _ in rows), COMMENT_COLUMN_MAX)
    return "\n".join(f"{text:{width}}  # {note}" if note else text for text, note in rows)


def _format_lead(keys: Keys, shared: int) -> str:
    """Return the indent of a line, with the dash of a list's item if it is the first in it."""
    indent = "  " * (len(keys) - 1)
    is_first = len(keys) > 1 and keys[-2].isdecimal() and shared < len(keys) - 1
    return f"{indent[:-2]}- " if is_first else indent


def _format_comment(each: ConfigValue) -> str:
    """Return what stands behind a value: its source, unit and what is allowed."""
    key = each.key
    unit = f"[{key.unit}] " if key.unit and not key.allowed.endswith(key.unit) else ""
    return (
        f"{each.source}; {unit}{key.allowed}".rstrip("; ") if unit or key.allowed else each.source
    )


def _to_finite(tree: Any) -> Any:
    """Return plain data with infinity as text."""
    if isinstance(tree, list):
        return [_to_finite(item) for item in tree]
    return str(tree) if isinstance(tree, float) and math.isinf(tree) else tree
