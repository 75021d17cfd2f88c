"""Message types of ROS 2, declared once as dataclasses.

A type is a frozen dataclass with the class variable `ros_name` and fields annotated with one of the
types below, or with another such dataclass. From that one declaration come the CDR bytes
(`teleop.ros.cdr`), the type hash (`teleop.ros.type_hash`) and the `.msg` text. The messages of
`teleop.messages.messages` are types of the package `tendon_teleop`.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from teleop.messages.messages import Message
from teleop.recording.names import SCHEMA_PACKAGE


@dataclass(frozen=True, slots=True)
class RosType:
    """Primitive type of a field; `count` is None for a scalar, 0 for a sequence of any length."""

    name: str
    count: int | None = None


Bool = Annotated[bool, RosType("bool")]
Byte = Annotated[int, RosType("byte")]
Int32 = Annotated[int, RosType("int32")]
UInt32 = Annotated[int, RosType("uint32")]
Float64 = Annotated[float, RosType("float64")]
Text = Annotated[str, RosType("string")]
Float64s = Annotated[tuple[float, ...], RosType("float64", 0)]
Texts = Annotated[tuple[str, ...], RosType("string", 0)]


@dataclass(frozen=True, slots=True)
class Field:
    """A field: a primitive type or, with `nested`, another interface."""

    name: str
    type: str  # "float64", or "std_msgs/msg/Header"
    count: int | None  # None = scalar, 0 = sequence, n = array
    nested: "Interface | None" = None

    @property
    def text(self) -> str:
        """The field as a line of a `.msg` file."""
        package, _, name = self.type.partition("/msg/")
        brackets = "" if self.count is None else f"[{self.count or ''}]"
        return f"{f'{package}/{name}' if name else package}{brackets} {self.name}"


@dataclass(frozen=True, slots=True, eq=False)
class Interface:
    """A message type: its name, such as `sensor_msgs/msg/JointState`, its fields and its class."""

    name: str
    fields: tuple[Field, ...]
    cls: type[Any]

    @property
    def text(self) -> str:
        """The `.msg` text, without the types that it refers to."""
        return "".join(f"{field.text}\n" for field in self.fields)

    @property
    def references(self) -> "tuple[Interface, ...]":
        """The types that it refers to, directly or not, each once, by name."""
        found = {one.name: one for one in self._below()}
        return tuple(found[name] for name in sorted(found))

    def _below(self) -> "Iterator[Interface]":
        for field in self.fields:
            if field.nested is not None:
                yield field.nested
                yield from field.nested._below()


def format_definition(interface: Interface) -> str:
    """Return the `.msg` text with those of all references, as MCAP's `ros2msg` wants it."""
    parts = [interface.text]
    for one in interface.references:
        package, _, name = one.name.partition("/msg/")
        parts.append(f"{'=' * 80}\nMSG: {package}/{name}\n{one.text}")
    return "".join(parts)


_INTERFACES: dict[type[Any], Interface] = {}


def find_interface(cls: type[Any]) -> Interface:
    """Return the interface that a dataclass declares; cached."""
    interface = _INTERFACES.get(cls)
    if interface is None:
        interface = _INTERFACES[cls] = _build_interface(cls)
    return interface


def _build_interface(cls: type[Any]) -> Interface:
    if issubclass(cls, Message):
        wires = cls.schema.wires.items()
        own = tuple(Field(n, w.ros, None if w.count == 1 else w.count) for n, w in wires)
        return Interface(f"{SCHEMA_PACKAGE}/msg/{cls.schema.name}", own, cls)
    hints = get_type_hints(cls, include_extras=True)
    found = tuple(_build_field(item.name, hints[item.name]) for item in fields(cls))
    return Interface(str(cls.ros_name), found, cls)


def _build_field(name: str, hint: Any) -> Field:
    primitive = next((a for a in get_args(hint) if isinstance(a, RosType)), None)
    if primitive is not None:
        return Field(name, primitive.name, primitive.count)
    if get_origin(hint) is tuple:  # tuple[X, ...]: a sequence of nested messages
        nested = find_interface(get_args(hint)[0])
        return Field(name, nested.name, 0, nested)
    nested = find_interface(hint)
    return Field(name, nested.name, None, nested)
