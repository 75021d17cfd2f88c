"""Strict YAML: unique keys, YAML 1.2 scalars, one-line errors."""

import re
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from teleop.errors import UsageError


class _Loader(yaml.SafeLoader):
    """YAML 1.2 scalars, and unique keys.

    PyYAML follows YAML 1.1, where `1e-3` is text, `012` is ten, `1:30` is ninety and `no` is
    false: each a trap in a file of physical constants.
    """

    yaml_implicit_resolvers: dict[Any, Any] = {}  # noqa: RUF012 - PyYAML's own shape

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
    _Loader.add_implicit_resolver(
        f"tag:yaml.org,2002:{_tag}", re.compile(f"^(?:{_pattern})$"), _first
    )


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


def read(path: Path, what: str = "config file") -> dict[str, Any]:
    """Read a config file, or one of another kind, whose top level is a mapping."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise UsageError(f"{path}: cannot read the {what}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: the {what} is not UTF-8 text") from error
    tree = parse(text, str(path))
    if tree is None:
        return {}
    if not isinstance(tree, dict):
        raise UsageError(f"{path}: the top level is not a mapping (key: value lines)")
    return tree
