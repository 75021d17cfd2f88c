"""Random values for every type that is sent or read, and messages as plain numbers."""

import dataclasses
import re
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from teleop.messages.messages import MESSAGES
from teleop.ros import message_types
from teleop.ros.message_types import build_message, load_typestore, to_type_name

STANDARD = tuple(
    value
    for key, value in vars(message_types).items()
    if key.isupper() and re.fullmatch(r"\w+/msg/\w+", str(value))
)
TYPES = (*STANDARD, *map(to_type_name, MESSAGES))


def value_of(name: str, rng: np.random.Generator) -> Any:
    """A message with a value of its own in every field; sequences of 0 to 4 elements."""
    fields = load_typestore().fielddefs[name][1]
    return build_message(
        name, **{field: _value(kind, detail, rng) for field, (kind, detail) in fields}
    )


def _value(kind: Nodetype, detail: Any, rng: np.random.Generator) -> Any:
    if kind == Nodetype.NAME:
        return value_of(detail, rng)
    if kind != Nodetype.BASE:  # a sequence or an array
        inner, count = detail
        values = [_value(*inner, rng) for _ in range(count or int(rng.integers(0, 5)))]
        number = inner[0] == Nodetype.BASE and inner[1][0] != "string"
        return np.array(values, _dtype(inner[1][0])) if number else values
    if detail[0] == "string":
        return "".join(rng.choice(list("aé_/ 1"), int(rng.integers(0, 9))))
    if detail[0] == "bool":
        return bool(rng.integers(2))
    dtype = _dtype(detail[0])
    if dtype.kind == "f":
        return float(rng.normal())
    return int(rng.integers(np.iinfo(dtype).max, dtype=dtype))


def _dtype(name: str) -> np.dtype[Any]:
    return np.dtype("i1" if name == "byte" else name)  # as `rosbags` has it


def as_tree(message: Any) -> Any:
    """A message as lists and plain numbers."""
    if dataclasses.is_dataclass(message):
        names = (field.name for field in dataclasses.fields(message))
        # without the type's name and constants, which `rosbags` has as fields
        return {n: as_tree(getattr(message, n)) for n in names if n[0].islower()}
    if hasattr(message, "__slots__") and not isinstance(message, np.ndarray):  # of `mcap_ros2`
        return {n: as_tree(getattr(message, n)) for n in message.__slots__}
    if isinstance(message, np.ndarray):
        return message.tolist()
    if isinstance(message, bytes):
        return list(message)
    return [as_tree(one) for one in message] if isinstance(message, list | tuple) else message
