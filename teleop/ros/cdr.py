"""CDR, the bytes of ROS 2 messages: plain, little-endian (XCDR version 1).

Four bytes of encapsulation, then each value at a multiple of its size, counted from their end. A
string is its length with the final zero byte (uint32), its UTF-8 bytes and that zero; a sequence is
its number of elements (uint32) and the elements. Source: OMG DDS-XTypes 1.3, 7.4.1.
"""

import struct
from typing import Any, TypeVar

from teleop.errors import TeleopError
from teleop.messages.messages import ENCAPSULATION
from teleop.ros.interface import Field, Interface, find_interface

T = TypeVar("T")

_CODES = {
    "bool": "?", "byte": "B", "char": "B",
    "int8": "b", "int16": "h", "int32": "i", "int64": "q",
    "uint8": "B", "uint16": "H", "uint32": "I", "uint64": "Q",
    "float32": "f", "float64": "d",
}  # fmt: skip
_SIZES = {name: struct.calcsize(code) for name, code in _CODES.items()}
_LENGTH_MAX = 100_000  # elements of a sequence, characters of a string: more is damage
# rclpy pads the empty sequences of a message in the length of its buffer, but not in its content: a
# JointState without positions and velocities has 12 further bytes of no meaning
_TRAILING_BYTES_MAX = 16
_U32 = struct.Struct("<I")


class CdrError(TeleopError):
    """Bytes that are no message of the expected type."""


def encode(message: Any) -> bytes:
    """Return the bytes of a message, an instance of a declared type (`teleop.ros.interface`)."""
    out = bytearray()
    _write_message(out, find_interface(type(message)), message)
    return ENCAPSULATION + bytes(out)


def decode(cls: type[T], data: bytes) -> T:
    """Return the message of type `cls` in `data`.

    Raises
    ------
    CdrError
        Too short, too long, not little-endian CDR, or text that is not UTF-8.
    """
    if data[:2] != ENCAPSULATION[:2]:
        raise CdrError("not little-endian CDR")
    body = memoryview(data)[len(ENCAPSULATION) :]
    interface = find_interface(cls)
    try:
        message, end = _read_message(body, 0, interface)
    except struct.error as error:
        raise CdrError(f"too short for {interface.name}") from error
    except UnicodeDecodeError as error:
        raise CdrError(f"text in {interface.name} is not UTF-8") from error
    if len(body) - end > _TRAILING_BYTES_MAX:
        raise CdrError(f"{len(body) - end} bytes too long for {interface.name}")
    result: T = message
    return result


def _write_message(out: bytearray, interface: Interface, message: Any) -> None:
    for field in interface.fields:
        value = getattr(message, field.name)
        if field.count is None:
            _write_value(out, field, value)
            continue
        if field.count == 0:
            _align_buffer(out, 4)
            out += _U32.pack(len(value))
        elif len(value) != field.count:
            raise CdrError(f"{field.name}: {len(value)} elements, must be {field.count}")
        code = _CODES.get(field.type)
        if code is None:
            for item in value:
                _write_value(out, field, item)
        elif len(value):
            _align_buffer(out, _SIZES[field.type])
            out += struct.pack(f"<{len(value)}{code}", *value)


def _write_value(out: bytearray, field: Field, value: Any) -> None:
    if field.nested is not None:
        _write_message(out, field.nested, value)
    elif field.type == "string":
        text = value.encode()
        _align_buffer(out, 4)
        out += _U32.pack(len(text) + 1)
        out += text
        out.append(0)
    else:
        _align_buffer(out, _SIZES[field.type])
        out += struct.pack("<" + _CODES[field.type], value)


def _align_buffer(out: bytearray, size: int) -> None:
    out.extend(bytes(-len(out) % size))


def _read_message(body: memoryview, at: int, interface: Interface) -> tuple[Any, int]:
    values: dict[str, Any] = {}
    for field in interface.fields:
        if field.count is None:
            values[field.name], at = _read_value(body, at, field)
            continue
        count = field.count
        if count == 0:
            count, at = _read_count(body, at)
        code = _CODES.get(field.type)
        if code is None:
            items = []
            for _ in range(count):
                value, at = _read_value(body, at, field)
                items.append(value)
            values[field.name] = tuple(items)
        else:
            at += -at % _SIZES[field.type] if count else 0
            values[field.name] = struct.unpack_from(f"<{count}{code}", body, at)
            at += count * _SIZES[field.type]
    return interface.cls(**values), at


def _read_value(body: memoryview, at: int, field: Field) -> tuple[Any, int]:
    if field.nested is not None:
        return _read_message(body, at, field.nested)
    if field.type == "string":
        length, at = _read_count(body, at)
        end = at + length
        if end > len(body):
            raise CdrError(f"{field.name}: a string ends beyond the message")
        return bytes(body[at:end]).rstrip(b"\0").decode(), end
    at += -at % _SIZES[field.type]
    return struct.unpack_from("<" + _CODES[field.type], body, at)[0], at + _SIZES[field.type]


def _read_count(body: memoryview, at: int) -> tuple[int, int]:
    at += -at % 4
    (count,) = _U32.unpack_from(body, at)
    if count > _LENGTH_MAX:
        raise CdrError(f"{count} elements announced, at most {_LENGTH_MAX} are read")
    return count, at + 4
