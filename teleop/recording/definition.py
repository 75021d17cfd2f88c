"""Parse ROS 2 message definitions of recorded messages."""

import re

import numpy as np

from teleop.messages.messages import ENCAPSULATION

_NUMPY = {
    "bool": "?", "byte": "u1", "char": "u1",
    "int8": "i1", "int16": "<i2", "int32": "<i4", "int64": "<i8",
    "uint8": "u1", "uint16": "<u2", "uint32": "<u4", "uint64": "<u8",
    "float32": "<f4", "float64": "<f8",
}  # fmt: skip
_FIELD = re.compile(r"(?P<type>\w+)(?:\[(?P<count>\d+)\])?\s+(?P<name>[a-zA-Z]\w*)(?P<rest>.*)")


def to_dtype(definition: str) -> np.dtype[np.void]:
    """Return the dtype of CDR messages with a given `ros2msg` definition.

    The dtype covers the whole message, its four-byte encapsulation header included, so
    `numpy.frombuffer(data, dtype)` reads one as recorded. It knows fields of fixed size, which are
    all that this project's messages have.

    Raises
    ------
    ValueError
        If the definition has a field of variable size or of another message type.
    """
    names, formats, offsets = [], [], []
    end = 0
    for line in definition.splitlines():
        text = line.partition("#")[0].strip()
        if not text:
            continue
        field = _FIELD.fullmatch(text)
        if field is None or field["type"] not in _NUMPY:
            raise ValueError(f"{text!r} is not a field of fixed size")
        if field["rest"].lstrip().startswith("="):
            continue  # constants take no bytes
        scalar = np.dtype(_NUMPY[field["type"]])
        count = 1 if field["count"] is None else int(field["count"])
        start = end + -end % scalar.itemsize
        end = start + count * scalar.itemsize
        names.append(field["name"])
        formats.append(scalar if field["count"] is None else (scalar, (count,)))
        offsets.append(len(ENCAPSULATION) + start)
    return np.dtype(
        {
            "names": names,
            "formats": formats,
            "offsets": offsets,
            "itemsize": len(ENCAPSULATION) + end,
        }
    )
