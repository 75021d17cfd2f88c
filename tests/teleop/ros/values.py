"""Values for every declared type, and the same types as `rosbags` knows them."""

import dataclasses
from functools import cache
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from teleop.messages.messages import MESSAGES
from teleop.ros import standard
from teleop.ros.interface import Field, Interface, find_interface

STANDARD = tuple(cls for cls in vars(standard).values() if hasattr(cls, "ros_name"))
TYPES = (*STANDARD, *MESSAGES)


@cache
def typestore() -> Typestore:
    """`rosbags` with the types of Jazzy, which it brings along, and those of other packages."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for cls in TYPES:
        interface = find_interface(cls)
        if interface.name not in store.fielddefs:
            store.register(get_types_from_msg(interface.text, interface.name))
    return store


def value_of(cls: type, rng: np.random.Generator) -> Any:
    """A message with a value of its own in every field; sequences of 0 to 4 elements."""
    interface = find_interface(cls)
    return cls(**{field.name: _value(field, rng) for field in interface.fields})


def _value(field: Field, rng: np.random.Generator) -> Any:
    if field.count is None:
        return _one(field, rng)
    count = field.count or int(rng.integers(0, 5))
    return tuple(_one(field, rng) for _ in range(count))


def _one(field: Field, rng: np.random.Generator) -> Any:
    if field.nested is not None:
        return value_of(field.nested.cls, rng)
    if field.type == "string":
        return "".join(rng.choice(list("aé_/ 1"), int(rng.integers(0, 9))))
    if field.type == "bool":
        return bool(rng.integers(2))
    if field.type.startswith("float"):
        return float(rng.normal())
    dtype = np.dtype("i1" if field.type == "byte" else field.type)  # as `rosbags` has it
    return int(rng.integers(0, np.iinfo(dtype).max, dtype=dtype))


def as_theirs(store: Typestore, interface: Interface, message: Any) -> Any:
    """The message as `rosbags` has it."""
    values = {}
    for field in interface.fields:
        value = getattr(message, field.name)
        if field.nested is not None:
            nested = field.nested
            value = (
                as_theirs(store, nested, value)
                if field.count is None
                else [as_theirs(store, nested, item) for item in value]
            )
        elif field.count is not None and field.type != "string":
            value = np.array(value, dtype=field.type)
        values[field.name] = value
    return store.types[interface.name](**values)


def as_tree(message: Any) -> Any:
    """A message of either kind as lists and plain numbers."""
    if dataclasses.is_dataclass(message):
        names = (field.name for field in dataclasses.fields(message))
        # without the type's name and constants, which `rosbags` has as fields
        return {n: as_tree(getattr(message, n)) for n in names if n[0].islower()}
    if isinstance(message, np.ndarray):
        return message.tolist()
    return [as_tree(one) for one in message] if isinstance(message, list | tuple) else message
