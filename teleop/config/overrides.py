"""`--set dotted.key=value`: what replaces values of a config file; the last one wins."""

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from teleop.config import strict_yaml
from teleop.errors import UsageError

LIST_INDEX = re.compile(r"0|[1-9][0-9]{0,8}")
"""A key that is the place of an item in a list."""

Keys = tuple[str, ...]
"""The keys on the way to a value."""


@dataclass(frozen=True, slots=True)
class Override:
    """One `--set` argument, or what a program puts in the place of one."""

    text: str
    keys: Keys
    value: Any

    @classmethod
    def from_value(cls, key: str, value: Any) -> "Override":
        """Return the override of a dotted key by a value of plain data."""
        return cls(f"{key}={json.dumps(value)}", tuple(key.split(".")), value)

    @classmethod
    def parse(cls, text: str) -> "Override":
        """Parse `dotted.key=value`; raises `UsageError`."""
        key, equals, value = text.partition("=")
        keys = tuple(key.strip().split("."))
        if not equals or not all(re.fullmatch(r"\w+", k) for k in keys):
            raise UsageError(f"--set {text}: expected dotted.key=value, e.g. master.force.scale=2")
        if re.fullmatch(r"\[[0-9A-Fa-f:.]*::?[0-9A-Fa-f:.]*\]:\d+", value):  # no YAML: [::1]:7451
            return cls(text, keys, value)
        return cls(text, keys, strict_yaml.parse(value, f"--set {text}"))


def find_override(overrides: Sequence[Override], keys: Keys) -> Override | None:
    """Return the last override that sets the value at `keys` or one of its parents."""
    for override in reversed(overrides):
        shared = min(len(keys), len(override.keys))
        if override.keys[:shared] == keys[:shared]:
            return override
    return None


def apply_override(
    node: Any, override: Override, error: Callable[[Keys, str], UsageError], depth: int = 0
) -> Any:
    """Return a copy of a config's tree with an override applied, below `depth` of its keys.

    Nodes on the way are copied: an alias in YAML makes one node of several places. `error` makes
    the error to raise of keys and what is wrong: an index beyond the end of a list.
    """
    if depth == len(override.keys):
        return override.value
    slot: Any = override.keys[depth]
    if isinstance(node, list):
        if not LIST_INDEX.fullmatch(slot) or int(slot) >= len(node):
            raise error(override.keys, f"the list has {len(node)} items, counted from 0")
        slot = int(slot)
        copy: Any = node.copy()
        inner = node[slot]
    else:
        copy = dict(node) if isinstance(node, dict) else {}
        inner = copy.get(slot)
    copy[slot] = apply_override(inner, override, error, depth + 1)
    return copy
