"""A message as bytes and as a record in the same memory, for the loops.

A loop keeps one `Packet` for each message that it sends or receives at every tick. Compiled
functions access its fields in place, `seal` fills in the head, and `Packet.data` are the bytes on
the wire, without packing.
"""

import zlib
from typing import Generic, TypeVar

import numpy as np

from estimator.structs import StructArray, view_struct
from teleop.messages.messages import CHECKSUM, CHECKSUM_START, ENCAPSULATION, HEAD, LAYOUT, Message

M = TypeVar("M", bound=Message)

_BODY_START = 8  # start of the body in a packet's memory: aligned, after the encapsulation
_HEAD_START = len(ENCAPSULATION)  # in the message


class Packet(Generic[M]):
    """One message, as bytes and as a record.

    `records`, shape (1,), are for compiled functions, `record` is a view of them with the fields of
    the message class. Writing to `data`, the bytes of the whole message, changes the record.
    """

    def __init__(self, message: type[M]) -> None:
        schema = message.schema
        memory = np.zeros(_BODY_START + schema.record_dtype.itemsize, dtype=np.uint8)
        memory[_BODY_START - len(ENCAPSULATION) : _BODY_START] = list(ENCAPSULATION)
        self.records: StructArray = memory[_BODY_START:].view(schema.record_dtype)
        self.record: M = view_struct(self.records)
        begin = _BODY_START - len(ENCAPSULATION)
        self.data = memory.data[begin : begin + schema.size]
        self._covered = self.data[CHECKSUM_START:]  # by the checksum
        self._seed = schema.seed

    def seal(self, sender: int, sequence: int, stamp_ns: int) -> bytes:
        """Fill in the head and return the bytes to send."""
        data = self.data
        HEAD.pack_into(data, _HEAD_START, 0, LAYOUT, sender, sequence, stamp_ns)
        CHECKSUM.pack_into(data, _HEAD_START, zlib.crc32(self._covered, self._seed))
        return data.tobytes()

    def fill(self, message: M) -> None:
        """Copy every field of a message object."""
        for name in message.schema.wires:
            setattr(self.record, name, getattr(message, name))
