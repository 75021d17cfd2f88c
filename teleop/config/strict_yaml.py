"""Strict YAML: unique keys, YAML 1.2 scalars, bounded size, one-line errors; its writer."""

import re
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from teleop.errors import UsageError
from teleop.runtime.files import read_small_file

SIZE_MAX = 100_000  # [B] of a file, which PyYAML parses in 2 to 4 s; that of two arms has 5 kB
VALUES_MAX = 100_000  # keys and values of a document, aliases written out


class _Loader(yaml.SafeLoader):
    """YAML 1.2 scalars, unique keys, and no more values than `VALUES_MAX`.

    PyYAML follows YAML 1.1, where `1e-3` is text, `012` is ten, `1:30` is ninety and `no` is
    false: each a trap in a file of physical constants.
    """

    yaml_implicit_resolvers: dict[Any, Any] = {}  # noqa: RUF012 - PyYAML's own shape

    def construct_document(self, node: yaml.Node) -> Any:
        """Build the document, unless it would be too large once its aliases are written out."""
        _count_values(node, {})
        return super().construct_document(node)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """Build a mapping whose keys are words, each once."""
        seen = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if not isinstance(key, str):
                problem = f"the key {key!r} is not text"
            elif key in seen:
                problem = f"the key {key!r} occurs twice"
            else:
                seen.add(key)
                continue
            raise yaml.constructor.ConstructorError(None, None, problem, key_node.start_mark)
        return super().construct_mapping(node, deep)


class _Dumper(yaml.SafeDumper):
    """Quotes text that YAML 1.1 or 1.2 would take for something else."""

    def represent_str(self, data: str) -> yaml.ScalarNode:
        """Write a next-line character as an escape: a plain one is read back as a blank."""
        style = '"' if "\x85" in data else None
        return self.represent_scalar("tag:yaml.org,2002:str", data, style=style)


_Dumper.add_representer(str, _Dumper.represent_str)

for _tag, _pattern, _first in (
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("bool", r"true|True|TRUE|false|False|FALSE", list("tTfF")),
    ("int", r"[-+]?(?:0|[1-9][0-9]*)", list("-+0123456789")),
    (
        "float",
        r"[-+]?(?:\.[0-9]+|[0-9]+\.[0-9]*)(?:[eE][-+]?[0-9]+)?|[-+]?[0-9]+[eE][-+]?[0-9]+"
        r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
        list("-+.0123456789"),
    ),
):
    for _side in (_Loader, _Dumper):
        _side.add_implicit_resolver(
            f"tag:yaml.org,2002:{_tag}", re.compile(f"^(?:{_pattern})$"), _first
        )


def _count_values(node: yaml.Node, counts: dict[yaml.Node, int | None]) -> int:
    """Return the number of keys and values below a node; raises `ConstructorError` if too many.

    Each node is visited once: `counts` holds those of finished ones, None while one is visited.
    """
    if node not in counts:
        counts[node] = None
        parts = node.value if isinstance(node, yaml.CollectionNode) else ()
        pairs = (child if isinstance(child, tuple) else (child,) for child in parts)
        counts[node] = 1 + sum(_count_values(child, counts) for pair in pairs for child in pair)
    count = counts[node]
    if count is None:
        problem = "an alias contains itself"
    elif count > VALUES_MAX:
        problem = f"has more than {VALUES_MAX} values, its aliases written out"
    else:
        return count
    raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)


def parse(text: str, place: str) -> Any:
    """Parse one YAML document; errors are one line."""
    try:
        return yaml.load(text, _Loader)  # noqa: S506 - a SafeLoader
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f", line {mark.line + 1}" if mark is not None else ""
        raise UsageError(f"{place}{line}: {error.problem or error.context}") from error
    except yaml.YAMLError as error:
        raise UsageError(f"{place}: not YAML text: {' '.join(str(error).split())}") from error
    except RecursionError as error:
        raise UsageError(f"{place}: nested too deeply") from error
    except ValueError as error:  # an integer with thousands of digits
        raise UsageError(f"{place}: {error}") from error


def format_document(tree: Any) -> str:
    """Return the YAML text that `parse` reads back as `tree`, of mappings, lists and scalars."""
    text: str = yaml.dump(tree, Dumper=_Dumper, sort_keys=False, allow_unicode=True)
    return text


def find_lines(text: str) -> dict[tuple[str, ...], int]:
    """Return the line, from 1, of each value of a document that `parse` accepts, by its keys.

    An item of a list has its place, from 0, as key. What an alias repeats is where it was written.
    """
    lines: dict[tuple[str, ...], int] = {}
    root = yaml.compose(text, _Loader)
    todo: list[tuple[tuple[str, ...], yaml.Node]] = [((), root)] if root is not None else []
    while todo:
        keys, node = todo.pop()
        entries: list[tuple[str, yaml.Node, yaml.Node]] = []
        if isinstance(node, yaml.MappingNode):
            entries = [(key.value, key, value) for key, value in node.value]
        elif isinstance(node, yaml.SequenceNode):
            entries = [(str(i), item, item) for i, item in enumerate(node.value)]
        for name, place, value in entries:
            lines[*keys, name] = place.start_mark.line + 1
            todo.append(((*keys, name), value))
    return lines


def read(path: Path, what: str = "config file") -> dict[str, Any]:
    """Read a config file, or one of another kind, whose top level is a mapping."""
    return parse_mapping(read_text(path, what), str(path))


def parse_mapping(text: str, place: str) -> dict[str, Any]:
    """Parse a YAML document whose top level is a mapping; an empty one has no keys."""
    tree = parse(text, place)
    if tree is None:
        return {}
    if not isinstance(tree, dict):
        raise UsageError(f"{place}: the top level is not a mapping (key: value lines)")
    return tree


def read_text(path: Path, what: str = "config file") -> str:
    """Read the text of a config file; `UsageError` if it is none, or larger than `SIZE_MAX`."""
    try:
        return read_small_file(path, SIZE_MAX).decode("utf-8-sig")
    except OSError as error:
        raise UsageError(f"{path}: cannot read the {what}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: the {what} is not UTF-8 text") from error
