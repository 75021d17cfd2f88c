"""The keys of a config: type, default, unit, meaning and allowed values, from the dataclasses.

Nothing is written twice. Types and defaults are those of the fields; unit and meaning are in the
comment of each field, or in the docstring of the section it holds; what is allowed is a `Literal`,
a stated range, and what `__post_init__` says as it refuses a value that is far off.
"""

import dataclasses
import re
import types
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from teleop.config.comments import read_field_comments
from teleop.config.extensions import Extension, list_entry_points
from teleop.config.loading import find_default
from teleop.config.ranges import Range
from teleop.errors import UsageError

Config = type[Any]
"""A config dataclass."""

REQUIRED = dataclasses.MISSING
"""The default of a key without one."""

_UNIT = re.compile(r"\[([^\]]+)\]\s*")
_SYMBOL = r"(?:s|m|N|Hz|J|kg|rad|V|A|K|MB|deg C|bit|counts?)(?:\^[\w.]+)?"
_UNITS = rf"(?:1/)?{_SYMBOL}(?:[ /]{_SYMBOL})*"
_FAR = (-1e30, 1e30)  # refused wherever there is a bound
_FAR_WHOLE = (-(10**12), 10**12)
_NO_TEXT = ("", "?!")
"""Texts that are neither a name, nor an address, nor anything else."""


@dataclasses.dataclass(frozen=True)
class Key:
    """A key of a section, as a user must know it."""

    name: str
    hint: Any  # annotation
    default: Any  # REQUIRED if there is none
    unit: str
    meaning: str
    allowed: str

    @property
    def kinds(self) -> tuple[Config, ...]:
        """The dataclasses that its value, or an item of it, may be; none of a plain value."""
        return tuple(_list_dataclasses(self.hint))

    @property
    def is_list(self) -> bool:
        """Whether the sections are the items of a list."""
        return get_origin(self.hint) is tuple

    @property
    def type(self) -> str:
        """The type, as text."""
        return _format_type(self.hint)


_described: dict[Config, tuple[Key, ...]] = {}


def describe_keys(config: Config) -> tuple[Key, ...]:
    """Return the keys of a section in the order of the fields."""
    if config not in _described:
        _described[config] = tuple(_describe_fields(config))
    return _described[config]


def _describe_fields(config: Config) -> Iterator[Key]:
    hints, comments = get_type_hints(config), read_field_comments(config)
    limits = _find_limits(config)
    for item in dataclasses.fields(config):
        if not item.init:
            continue
        hint, comment = hints[item.name], comments.get(item.name, "")
        kinds = tuple(_list_dataclasses(hint))
        unit, meaning = _split_unit(comment, item.metadata.get("range"))
        if item.name == "type":
            meaning = meaning or "kind of this section"
        if not meaning and kinds:
            meaning = read_summary(kinds[0])
        allowed = "" if kinds else limits[item.name]
        yield Key(item.name, hint, find_default(item), unit, meaning, allowed)


def read_summary(config: Config) -> str:
    """Return the first paragraph of the docstring of a section, without its full stop."""
    text = (config.__doc__ or "").partition("\n\n")[0]
    return " ".join(text.split()).removesuffix(".")


def find_tag(config: Config) -> str:
    """Return the value of the key `type` that chooses this section, empty if there is none."""
    hint = get_type_hints(config).get("type")
    return str(get_args(hint)[0]) if get_origin(hint) is Literal else ""


def list_tags(kinds: Iterable[Config]) -> list[str]:
    """Return the values that the key `type` may have: our kinds, and installed extensions."""
    tags = []
    for kind in kinds:
        tags += sorted(list_entry_points(kind)) if issubclass(kind, Extension) else [find_tag(kind)]
    return tags


# --- types


def _list_dataclasses(hint: Any) -> Iterator[Config]:
    if dataclasses.is_dataclass(hint):
        yield hint  # type: ignore[misc]
    elif get_origin(hint) in (Union, types.UnionType, tuple):
        for argument in get_args(hint):
            yield from _list_dataclasses(argument)


def _format_type(hint: Any) -> str:
    origin, args = get_origin(hint), get_args(hint)
    if origin is tuple:
        items = args[:1] if args[-1] is Ellipsis else args
        count = "list of" if args[-1] is Ellipsis else f"list of {len(args)}"
        return f"{count} {_format_plural(items[0])}"
    if origin in (Union, types.UnionType):
        names = dict.fromkeys(map(_format_type, args))  # unions of sections are one word
        return " or ".join(names)
    if origin is Literal:
        return _format_type(type(args[0]))
    if dataclasses.is_dataclass(hint):
        return "section"
    words = {bool: "boolean", int: "integer", float: "number", str: "text", Path: "path"}
    return "null" if hint is type(None) else words[hint]


def _format_plural(hint: Any) -> str:
    text = _format_type(hint)
    return text.replace("list", "lists", 1) if text.startswith("list") else f"{text}s"


# --- unit and meaning


def _split_unit(comment: str, stated: Range | None) -> tuple[str, str]:
    """Return the unit in a comment, or of a stated range, and the comment without it."""
    for found in _UNIT.finditer(comment):
        if re.fullmatch(_UNITS, found[1]):
            rest = comment[: found.start()] + comment[found.end() :]
            return found[1], rest.replace(" ,", ",").strip(" ;,")
    unit = stated.unit if stated is not None and re.fullmatch(_UNITS, stated.unit) else ""
    return unit, comment


# --- what is allowed


def _find_limits(config: Config) -> dict[str, str]:
    """Return what a section allows its plain keys, as text; empty without a bound."""
    hints = get_type_hints(config)
    limits: dict[str, str] = {}
    example = _build_example(config)
    for item in dataclasses.fields(config):
        hint = hints[item.name]
        words = [_format_choices(hint)]
        if "range" in item.metadata:
            words.append(str(item.metadata["range"]))
        if example is not None and get_origin(hint) is not Literal:
            words += _ask_for_limits(example, item.name, hint)
        others = [".inf"] * ("may_be_infinite" in item.metadata)
        others += ["null"] * (type(None) in get_args(hint))
        text = "; ".join(dict.fromkeys(filter(None, words)))
        alternatives = " or ".join(others)
        if text and alternatives:
            text = f"{text}, or {alternatives}"
        limits[item.name] = text or f"may be {alternatives}" * bool(alternatives)
    return limits


def _format_choices(hint: Any) -> str:
    """Return the choices that a type leaves, empty if it has none."""
    if get_origin(hint) is Literal:
        values = get_args(hint)
        return "one of " * (len(values) > 1) + ", ".join(map(str, values))
    if get_origin(hint) in (Union, types.UnionType):
        members = [member for member in get_args(hint) if member is not type(None)]
        choices = [_format_choices(m) or f"a {_format_type(m)}" for m in members]
        return ", or ".join(choices) if any(map(_format_choices, members)) else ""
    return ""


def _ask_for_limits(example: Any, name: str, hint: Any) -> list[str]:
    """Return what a section says of a field as it refuses values that are far off."""
    answers = []
    for value in _list_far_values(hint):
        try:
            dataclasses.replace(example, **{name: value})
        except (ValueError, TypeError, ArithmeticError) as error:
            field, _, rule = " ".join(str(error).split()).partition(": ")
            rule = _shorten_rule(rule, value)
            if re.sub(r"[\[.]\d+\]?$", "", field) == name and rule:
                answers.append(rule)
    return answers


def _list_far_values(hint: Any) -> Iterator[Any]:
    """Yield values of a type that a bound would refuse."""
    origin, args = get_origin(hint), get_args(hint)
    if hint is float:
        yield from _FAR
    elif hint is int:
        yield from _FAR_WHOLE
    elif hint is str:
        yield from _NO_TEXT
    elif origin in (Union, types.UnionType):
        for argument in args:
            yield from _list_far_values(argument)
    elif origin is tuple:
        count = 1 if args[-1] is Ellipsis else len(args)
        for far in _list_far_values(args[0]):
            yield (far,) * count


def _shorten_rule(rule: str, value: Any) -> str:
    """Return the rule in a message that refuses `value`, empty if it only repeats the value."""
    while isinstance(value, tuple):
        value = value[0]
    for shown in (repr(value), *([] if isinstance(value, str) else [f"{value:g}"])):
        rule = re.sub(rf"^{re.escape(shown)}( \S+)?(,| is outside) ", "", rule)
    rule = re.sub(r"^(must be|allowed are|.*allowed:) (within )?", "", rule)
    rule = re.sub(r"^must not be |^is (?=empty)", "not ", rule).partition("; check the unit")[0]
    rule = re.sub(rf"\[({_UNITS})\]", r"\1", rule).replace(" ... ", " to ")
    return "" if repr(value) in rule else rule


def _build_example(config: Config) -> Any:
    """Return a valid section, its defaults where they will do; None if there is none so simple."""
    hints, values = get_type_hints(config), {}
    for item in dataclasses.fields(config):
        if item.init and find_default(item) is REQUIRED:
            values[item.name] = _build_value(hints[item.name])
    for _ in range(2):  # where neither of two alternatives is a default, take the first
        try:
            return config(**values)
        except UsageError:
            return None
        except ValueError as error:
            name = re.match(r"\w+", str(error))
            if name is None or name[0] not in hints:
                return None
            values[name[0]] = _build_value(hints[name[0]])
    return None


def _build_value(hint: Any) -> Any:
    """Return a simple value of a type."""
    origin, args = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return _build_value(args[0])
    if origin is tuple:
        return tuple(map(_build_value, args[:1] if args[-1] is Ellipsis else args))
    if dataclasses.is_dataclass(hint):
        return _build_example(hint)  # type: ignore[arg-type]
    return hint("1") if hint in (str, Path) else hint(1)
