"""Strict conversion of YAML to nested frozen dataclasses.

Each config dataclass is next to the code it configures, with a default for every field. Ranges are
stated by the fields (`teleop.config.ranges`) and checked, as all else, in `__post_init__` by
`ValueError("field: what is wrong, what is allowed")`. This module reads a file and `--set
key=value` (`overrides`) once, as a `ConfigDocument`, and builds such dataclasses from it, using
only their annotations:

=========================== =====================================================================
annotation                  what the file may say
=========================== =====================================================================
`bool` `int` `float` `str`  that, and nothing converted into it (a whole number will do for `float`)
`Path`                      text; relative to the config file's folder
`Literal["a", "b"]`         one of the values
`X | None`                  X, or `null`
`A | B` (dataclasses)       a mapping whose key `type` names one of them
`tuple[X, ...]`             a list
dataclass                   a mapping; keys left out keep their defaults
=========================== =====================================================================

Numbers are finite, unless the field's default is infinite or it says `metadata=MAY_BE_INFINITE`.
Anything else is a `UsageError` of one line: file, dotted key, what it is, what is allowed.
"""

import dataclasses
import json
import math
import re
import types
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from teleop.config import strict_yaml
from teleop.config.extensions import (
    Extension,
    ExtensionError,
    list_entry_points,
    name_class,
    resolve_class,
)
from teleop.config.overrides import LIST_INDEX, Override, apply_override, find_override
from teleop.config.suggestions import suggest_spelling
from teleop.errors import UsageError

SESSION_KEYS = (  # of teleop.launch.config.SessionConfig, which only `teleop run` may import
    *("session", "rate_hz", "link", "confidence", "coupling", "health", "realtime", "arms"),
    *("master", "slave", "record", "view", "impair", "ros", "router"),
)
RECORDING_SUFFIX = ".mcap"  # a recording is a config file, too: that of its session
SNAPSHOT_SUFFIX = ".snapshot"  # and so is what a launcher gives the processes that it starts
_OTHER_FILES = {  # by a key that they alone have; the first that is there counts
    "bend": "the columns of a pair of tendons: teleop pair FILES --columns FILE",
    "columns": "the mapping of tables: teleop data show TABLE --mapping FILE",
    "tendons": "a calibration: name it in slave.calibration",
    "base": "a model of `teleop diagnose`: name it as model_file in slave.tendons",
    "signs": "the force signs of devices: name it as signs in master.device",
}
_RUN_SPECIFIC_KEYS = ("session", "link")  # where a session ran; another one takes its own place

T = TypeVar("T")

_FIELD_ERROR_PATTERN = re.compile(
    r"^(?P<field>[A-Za-z_]\w*)(?P<rest>[\w.\[\]]*): (?P<what>.*)$", re.DOTALL
)


def load(path: Path | None, cls: type[T], section: str | None, overrides: Sequence[str] = ()) -> T:
    """Read a config file, and build `cls` from it: `ConfigDocument.read` and its `load`."""
    return ConfigDocument.read(path, overrides).load(cls, section)


def as_tree(config: Any) -> Any:
    """Return a config as plain YAML values; the inverse of `load`."""
    if dataclasses.is_dataclass(config) and not isinstance(config, type):
        tree = {
            f.name: as_tree(getattr(config, f.name)) for f in dataclasses.fields(config) if f.init
        }
        return tree | {"type": name_class(config)} if isinstance(config, Extension) else tree
    if isinstance(config, tuple):
        return [as_tree(item) for item in config]
    return str(config) if isinstance(config, Path) else config


@dataclasses.dataclass(frozen=True)
class ConfigDocument:
    """A config file and the overrides of its values: read once, from then on data."""

    path: Path | None = None  # the file, or a recording; None for defaults throughout
    text: str = ""  # of the file
    recorded: tuple[Override, ...] = ()  # of the session of a recording
    overrides: tuple[Override, ...] = ()  # the last one wins

    @classmethod
    def read(cls, path: Path | None, overrides: Sequence[str] = ()) -> "ConfigDocument":
        """Read a config file, a recording or a snapshot; `UsageError` if it cannot be read.

        `overrides` are texts `dotted.key=YAML value`, as of `--set`.
        """
        parsed = tuple(map(Override.parse, overrides))
        if path is None:
            return cls(overrides=parsed)
        if path.suffix == RECORDING_SUFFIX:
            from teleop.recording.reader import read_recorded_config

            text, recorded, files = read_recorded_config(path)
            extracted = _extract_files(files)
            return cls(path, text, (*map(Override.parse, recorded), *extracted), parsed)
        if path.suffix == SNAPSHOT_SUFFIX:
            return _read_snapshot(path).override(*parsed)
        return cls(path, strict_yaml.read_text(path), overrides=parsed)

    def save_snapshot(self, path: Path) -> Path:
        """Write a file for the `--config` of another process; return its path."""
        path = path.with_suffix(SNAPSHOT_SUFFIX)
        path.write_text(json.dumps(dataclasses.asdict(self), default=str))
        return path

    def override(self, *overrides: Override) -> "ConfigDocument":
        """Return this document with further overrides."""
        return dataclasses.replace(self, overrides=(*self.overrides, *overrides))

    @cached_property
    def tree(self) -> dict[str, Any]:
        """What the file and the overrides state, as nested mappings, unchecked; `UsageError`."""
        tree = strict_yaml.parse_mapping(self.text, str(self.path))
        for override in self.recorded:
            tree = apply_override(tree, override, self.build_error)
        if self.path is not None and self.path.suffix == RECORDING_SUFFIX:
            tree = {key: value for key, value in tree.items() if key not in _RUN_SPECIFIC_KEYS}
        for override in self.overrides:
            tree = apply_override(tree, override, self.build_error)
        return tree

    def load(self, cls: type[T], section: str | None = None) -> T:
        """Build the config dataclass `cls` from one section; `UsageError` if it is invalid.

        Without a `section` the fields of `cls` are top-level keys: some of those of a session's
        config, or all keys of another kind of file.
        """
        own = tuple(f.name for f in dataclasses.fields(cast(Any, cls)))
        known = SESSION_KEYS if section is not None or set(own) <= set(SESSION_KEYS) else own
        for key in self.tree:
            if key not in known:
                kind = next((text for name, text in _OTHER_FILES.items() if name in self.tree), "")
                if kind and known is SESSION_KEYS:
                    raise self.build_error((key,), f"is no key of a session: this is {kind}")
                raise self.build_error((key,), f"unknown key{_format_suggestion(key, known)}")
        if section is not None:
            return cast(
                T, _Builder(self).build_dataclass(cls, self.tree.get(section), (section,), None)
            )
        mine = {key: value for key, value in self.tree.items() if key in own}
        return cast(T, _Builder(self).build_dataclass(cls, mine, (), None))

    def resolve_path(self, text: str, keys: tuple[str, ...]) -> Path:
        """Return the path at `keys`: relative to the folder of the file, or of an override."""
        try:
            path = Path(text).expanduser()
        except RuntimeError as error:
            raise self.build_error(keys, f"{_format_value(text)}: no such home folder") from error
        if self.path is None or find_override(self.overrides, keys) is not None:
            return path
        return self.path.parent / path

    def build_error(self, keys: tuple[str, ...], what: str) -> UsageError:
        """Return the error to raise about the value at `keys`."""
        override = find_override(self.overrides, keys) if keys else None
        if override is not None:
            place = f"--set {override.text}"
        else:
            place = "defaults" if self.path is None else str(self.path)
        dotted = ".".join(keys)
        return UsageError(f"{place}: {dotted}: {what}" if dotted else f"{place}: {what}")


_extracted: list[Any] = []  # folders that last as long as this process


def _extract_files(files: Mapping[str, bytes]) -> list[Override]:
    """Write the files of a recording to a temporary folder; return what names them there."""
    if not files:
        return []
    from teleop.runtime.scratch_folder import ScratchFolder

    _extracted.append(ScratchFolder())
    overrides = []
    for number, (key, data) in enumerate(files.items()):
        path = Path(_extracted[-1].name) / f"{number}.urdf"
        path.write_bytes(data)
        overrides.append(Override.from_value(key, str(path)))
    return overrides


def _read_snapshot(path: Path) -> ConfigDocument:
    """Return what `save_snapshot` has written; `UsageError`."""
    try:
        data = json.loads(path.read_bytes())
        recorded, overrides = (
            tuple(Override(each["text"], tuple(each["keys"]), each["value"]) for each in data[name])
            for name in ("recorded", "overrides")
        )
        file = data["path"] and Path(data["path"])
        return ConfigDocument(file, str(data["text"]), recorded, overrides)
    except OSError as error:
        raise UsageError(f"{path}: cannot read the config file: {error.strerror}") from error
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise UsageError(f"{path}: is no snapshot of a session's config") from error


class _Builder:
    """Builds values from a YAML tree by annotations."""

    def __init__(self, source: ConfigDocument) -> None:
        self.source = source

    def build_dataclass(self, cls: type[Any], data: Any, keys: tuple[str, ...], base: Any) -> Any:
        """Build `cls` from a mapping; missing keys come from `base` or from the defaults."""
        data = {} if data is None else data  # an empty section
        if not isinstance(data, dict):
            raise self.source.build_error(
                keys, f"{_format_value(data)} is not a mapping (key: value lines)"
            )
        hints = get_type_hints(cls)
        fields = {f.name: f for f in dataclasses.fields(cls) if f.init}
        for key in data:
            if key not in fields:
                raise self.source.build_error(
                    (*keys, str(key)), f"unknown key{_format_suggestion(key, fields)}"
                )
        values = {}
        for name, item in fields.items():
            preset = getattr(base, name) if isinstance(base, cls) else find_default(item)
            if name in data:
                allow = "may_be_infinite" in item.metadata or item.default == math.inf
                values[name] = self.build_value(
                    hints[name], data[name], (*keys, name), preset, allow
                )
            elif preset is dataclasses.MISSING:
                raise self.source.build_error(
                    (*keys, name), f"is missing; it is {_describe_annotation(hints[name])}"
                )
            else:
                values[name] = preset
        try:
            return cls(**values)
        except ValueError as error:
            raise self._build_refusal(error, fields, values, keys) from error

    def _build_refusal(
        self,
        error: ValueError,
        fields: Iterable[str],
        values: Mapping[str, Any],
        keys: tuple[str, ...],
    ) -> UsageError:
        """Prefix the message of a `__post_init__` with its place."""
        if isinstance(error, UsageError):
            return error
        found = _FIELD_ERROR_PATTERN.match(" ".join(str(error).split()))
        if found is None or found["field"] not in fields:
            return self.source.build_error(keys, " ".join(str(error).split()))
        inner = re.findall(r"\w+", found["rest"])
        value, what = values[found["field"]], found["what"]
        for name in inner:
            value = value[int(name)] if isinstance(value, tuple) else getattr(value, name, None)
        shows_value = isinstance(value, int | float | str | Path) and str(value) not in what
        shown = f"{_format_value(value)}: " if shows_value else ""
        return self.source.build_error((*keys, found["field"], *inner), shown + what)

    def build_value(
        self, hint: Any, data: Any, keys: tuple[str, ...], preset: Any, infinite: bool = False
    ) -> Any:
        """Convert `data` to the type `hint`, or raise."""
        origin = get_origin(hint)
        if origin in (Union, types.UnionType):
            return self._build_union(get_args(hint), data, keys, preset, infinite)
        if origin is Literal:
            allowed = get_args(hint)
            if not any(data == a and type(data) is type(a) for a in allowed):
                raise self._build_type_error(
                    hint, data, keys, _format_suggestion(data, allowed, listed=False)
                )
            return data
        if origin is tuple:
            return self._build_tuple(get_args(hint), hint, data, keys, preset, infinite)
        if dataclasses.is_dataclass(hint) and isinstance(hint, type):
            return self.build_dataclass(hint, data, keys, preset)
        if hint is float:
            return self._build_float(data, keys, infinite)
        if hint is Path and isinstance(data, str) and data:
            return self.source.resolve_path(data, keys)
        if hint in (bool, int, str) and type(data) is hint:
            return data
        if hint in (bool, int, str, Path):
            quote = "; put it in quotes" if hint is str and isinstance(data, int | float) else ""
            raise self._build_type_error(hint, data, keys, quote)
        raise TypeError(f"{'.'.join(keys)}: config fields cannot be of type {hint!r}")

    def _build_type_error(
        self, hint: Any, data: Any, keys: tuple[str, ...], more: str = ""
    ) -> UsageError:
        return self.source.build_error(
            keys, f"{_format_value(data)} is not {_describe_annotation(hint)}{more}"
        )

    def _build_float(self, data: Any, keys: tuple[str, ...], infinite: bool) -> float:
        if infinite and data in ("inf", "+inf", "-inf"):
            data = float(data)
        if isinstance(data, bool) or not isinstance(data, int | float):
            raise self._build_type_error(float, data, keys, " (or .inf)" * infinite)
        try:
            number = float(data)
        except OverflowError:
            number = math.inf
        if math.isnan(number) or (math.isinf(number) and not infinite):
            raise self.source.build_error(keys, f"{_format_value(data)} is not a finite number")
        return number

    def _build_tuple(
        self,
        args: tuple[Any, ...],
        hint: Any,
        data: Any,
        keys: tuple[str, ...],
        preset: Any,
        infinite: bool,
    ) -> tuple[Any, ...]:
        bases: tuple[Any, ...] = ()
        if isinstance(data, dict) and data and isinstance(preset, tuple):  # --set key.0.name=...
            bases, changed = preset, data
            if "type" in changed:  # of one item, without its brackets
                item = f"; [{{type: {changed['type']}, ...}}] is wanted"
                raise self._build_type_error(hint, data, keys, item)
            if not all(LIST_INDEX.fullmatch(str(k)) and int(k) < len(bases) for k in changed):
                count = f"the list has {len(bases)} items, counted from 0"
                raise self.source.build_error((*keys, str(next(iter(changed)))), count)
            data = [changed.get(str(i), base) for i, base in enumerate(bases)]
        if not isinstance(data, list):
            raise self._build_type_error(hint, data, keys)
        many = len(args) == 2 and args[1] is Ellipsis
        if not many and len(data) != len(args):
            raise self.source.build_error(keys, f"has {len(data)} items, {len(args)} are needed")
        built = []
        for i, item in enumerate(data):
            if bases and item is bases[i]:
                built.append(item)
                continue
            base = bases[i] if bases else dataclasses.MISSING
            built.append(
                self.build_value(
                    args[0] if many else args[i], item, (*keys, str(i)), base, infinite
                )
            )
        return tuple(built)

    def _build_union(
        self,
        members: tuple[Any, ...],
        data: Any,
        keys: tuple[str, ...],
        preset: Any,
        infinite: bool,
    ) -> Any:
        if data is None and type(None) in members:
            return None
        classes = [m for m in members if dataclasses.is_dataclass(m)]
        if isinstance(data, dict) and classes:
            return self.build_dataclass(
                self._build_tagged(classes, data, keys, preset), data, keys, preset
            )
        rest = [m for m in members if m is not type(None) and m not in classes]
        if isinstance(data, list):
            rest = [m for m in rest if get_origin(m) is tuple] or rest
        else:
            rest = [m for m in rest if get_origin(m) is not tuple] or rest
        if len(rest) == 1 and not classes:
            return self.build_value(rest[0], data, keys, preset, infinite)
        for member in rest:
            try:
                return self.build_value(member, data, keys, preset, infinite)
            except UsageError:  # try the next member
                continue
        named = len(classes) > 1 and isinstance(data, str) and data in _index_by_tag(classes)
        meant = f"; {{type: {data}, ...}} is wanted" if named else ""
        raise self._build_type_error(Union[members], data, keys, meant)  # noqa: UP007 - built at run time

    def _build_tagged(
        self, classes: list[Any], data: Any, keys: tuple[str, ...], preset: Any
    ) -> type[Any]:
        """Pick the dataclass that `data` names by its key `type`, or else the preset's."""
        if len(classes) == 1 and not issubclass(classes[0], Extension):
            return cast(type[Any], classes[0])
        by_tag = _index_by_tag(classes)
        if "type" not in data and type(preset) in classes:
            return type(preset)
        tag = data.get("type")
        others = [c for c in classes if issubclass(c, Extension)]
        if others and isinstance(tag, str) and (":" in tag or tag in list_entry_points(others[0])):
            try:
                return resolve_class(tag, others[0])
            except ExtensionError as error:
                raise self.source.build_error((*keys, "type"), str(error)) from error
        if not isinstance(tag, str) or tag not in by_tag:
            problem = "is missing" if tag is None else f"{_format_value(tag)} is unknown"
            suggestion = _format_suggestion(tag, by_tag)
            guide = _GUIDES.get(others[0].GROUP if others else keys[-1], "")
            raise self.source.build_error((*keys, "type"), f"{problem}{suggestion}{guide}")
        return cast(type[Any], by_tag[tag])


_GUIDES = {  # by group of entry points or key, for what is driven by a package of its own
    **dict.fromkeys(
        ("motors", "cells"),
        "; EtherCAT, ODrive, moteus, Feetech and others: a rig of your own (docs/how-to/rigs.md)",
    ),
    "teleop.devices": "; an arm such as a Touch, omega, Falcon or Inverse3: as a ROS node (type "
    "ros) or a device of your own (docs/how-to/haptic-device.md)",
    "teleop.rigs": "; other hardware: a rig of your own (docs/how-to/rigs.md)",
}


def _index_by_tag(classes: Iterable[Any]) -> dict[str, Any]:
    """Return the dataclasses of a union by the value of their key `type`."""
    built_in = [c for c in classes if not issubclass(c, Extension)]
    return {get_args(get_type_hints(c)["type"])[0]: c for c in built_in}


def find_default(item: "dataclasses.Field[Any]") -> Any:
    """Return the default of a field, `dataclasses.MISSING` if it has none."""
    if item.default_factory is not dataclasses.MISSING:
        return item.default_factory()
    return item.default


def _format_value(value: Any) -> str:
    """Return a value for an error message: short, on one line."""
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    text = repr(str(value) if isinstance(value, Path) else value)
    return text if len(text) <= 60 else text[:57] + "..."


def _format_suggestion(problem: Any, known: Iterable[Any], listed: bool = True) -> str:
    """Return the allowed values and the closest match."""
    names = [str(k) for k in known]
    return suggest_spelling(str(problem), names) + (
        f" (allowed: {', '.join(sorted(names))})" if listed else ""
    )


def _describe_members(members: Iterable[Any]) -> list[str]:
    """Return the members of a union as text, tagged dataclasses as one."""
    classes = [m for m in members if dataclasses.is_dataclass(m)]
    words = [_describe_annotation(m) for m in members if m not in classes]
    if len(classes) > 1:
        return ["{type: ..., ...}", *words]
    return [*map(_describe_annotation, classes), *words]


def _describe_annotation(hint: Any) -> str:
    """Return an annotation as text."""
    origin, args = get_origin(hint), get_args(hint)
    if origin is Literal:
        return "one of " + ", ".join(map(_format_value, args))
    if origin is tuple:
        return f"a list (of {_describe_annotation(args[0])})"
    if origin in (Union, types.UnionType):
        return " or ".join(_describe_members(args))
    if dataclasses.is_dataclass(hint):
        return "a mapping (key: value lines)"
    words = {
        bool: "true or false",
        int: "a whole number",
        float: "a number",
        str: "text",
        Path: "a path",
        type(None): "null",
    }
    return words.get(hint, str(hint))
