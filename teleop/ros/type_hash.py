"""Type hashes of ROS 2 message types: RIHS01.

SHA-256 of the type description as JSON: the names and types of the fields, and the descriptions of
all types referred to, sorted by name. Source: REP 2011 and the design page "ROS 2 type hash"
(`rosidl_generator_type_description`); the numbers are those of
`type_description_interfaces/msg/FieldType`.
"""

import hashlib
import json
from typing import Any

from teleop.ros.interface import Field, Interface, find_interface

_NUMBERS = {
    "int8": 2, "uint8": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7, "int64": 8,
    "uint64": 9, "float32": 10, "float64": 11, "bool": 15, "byte": 16, "string": 17,
}  # fmt: skip
_NESTED, _ARRAY, _SEQUENCE = 1, 48, 144


def compute_type_hash(cls: type[Any]) -> str:
    """Return the hash of a declared type, `RIHS01_` and 64 hexadecimal digits."""
    interface = find_interface(cls)
    described = {
        "type_description": _describe_interface(interface),
        "referenced_type_descriptions": [_describe_interface(one) for one in interface.references],
    }
    return f"RIHS01_{hashlib.sha256(json.dumps(described).encode()).hexdigest()}"


def _describe_interface(interface: Interface) -> dict[str, Any]:
    fields = [{"name": field.name, "type": _describe_type(field)} for field in interface.fields]
    return {"type_name": interface.name, "fields": fields}


def _describe_type(field: Field) -> dict[str, Any]:
    number = _NESTED if field.nested is not None else _NUMBERS[field.type]
    if field.count is not None:
        number += _ARRAY if field.count else _SEQUENCE
    return {
        "type_id": number,
        "capacity": field.count or 0,
        "string_capacity": 0,
        "nested_type_name": "" if field.nested is None else field.type,
    }
