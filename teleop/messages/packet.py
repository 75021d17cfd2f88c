"""A message as bytes and as a record in the same memory, for the loops.

A loop keeps one `Packet` for each message that it sends or receives at every tick. Compiled
functions access its fields in place, `seal_message` fills in the head, and `Packet.data` are the
bytes on the wire, without packing.
"""

from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import jit_compile
from estimator.records import StructArray, view_struct
from teleop.messages.messages import ENCAPSULATION, LAYOUT, Message, Schema

M = TypeVar("M", bound=Message)
Bytes = NDArray[np.uint8]

_BODY_START = 8  # start of the body in a packet's memory: aligned, after the encapsulation
_HEAD = Schema(Message).record_dtype
_CHECKSUM_START = _BODY_START + 4  # the checksum covers everything after it

_CRC_32 = 0xEDB88320  # the polynomial of zlib.crc32, reflected


def _build_crc_tables() -> NDArray[np.uint32]:
    """Return the tables of the slicing-by-8 algorithm (Kounavis & Berry 2008), shape (8, 256)."""
    tables = np.zeros((8, 256), dtype=np.uint32)
    for byte in range(256):
        value = byte
        for _ in range(8):
            value = (value >> 1) ^ (_CRC_32 if value & 1 else 0)
        tables[0, byte] = value
    for k in range(1, 8):
        previous = tables[k - 1]
        tables[k] = (previous >> 8) ^ tables[0, previous & 0xFF]
    return tables


_TABLES = _build_crc_tables()


@jit_compile
def crc32(data: Bytes, seed: int) -> int:
    """Compiled equivalent of `zlib.crc32(data, seed)`."""
    crc = np.uint32(seed) ^ np.uint32(0xFFFFFFFF)
    i, n = 0, len(data)
    while i + 8 <= n:
        low = crc ^ (
            np.uint32(data[i])
            | np.uint32(data[i + 1]) << np.uint32(8)
            | np.uint32(data[i + 2]) << np.uint32(16)
            | np.uint32(data[i + 3]) << np.uint32(24)
        )
        crc = (
            _TABLES[7, low & np.uint32(0xFF)]
            ^ _TABLES[6, (low >> np.uint32(8)) & np.uint32(0xFF)]
            ^ _TABLES[5, (low >> np.uint32(16)) & np.uint32(0xFF)]
            ^ _TABLES[4, low >> np.uint32(24)]
            ^ _TABLES[3, data[i + 4]]
            ^ _TABLES[2, data[i + 5]]
            ^ _TABLES[1, data[i + 6]]
            ^ _TABLES[0, data[i + 7]]
        )
        i += 8
    while i < n:
        crc = _TABLES[0, (crc ^ data[i]) & np.uint32(0xFF)] ^ (crc >> np.uint32(8))
        i += 1
    return int(crc ^ np.uint32(0xFFFFFFFF))


@jit_compile
def seal_message(
    memory: Bytes,
    heads: StructArray,
    size: int,
    seed: int,
    sender: np.uint64,
    sequence: int,
    stamp_ns: int,
) -> None:
    """Fill in the head of a complete message; `size` [bytes] is that of its body.

    `heads` is the same type for all messages, so that this is compiled once, not at the first
    message of each kind, in the middle of a session.
    """
    head = heads[0]
    head.layout = LAYOUT
    head.sender = sender
    head.sequence = sequence
    head.stamp_ns = stamp_ns
    head.checksum = crc32(memory[_CHECKSUM_START : _BODY_START + size], seed)


class Packet(Generic[M]):
    """One message, as bytes and as a record.

    Attributes
    ----------
    records : Records
        Shape (1,), for compiled functions.
    record : M
        A view of it, with the fields of the message class.
    data : memoryview
        The bytes of the whole message; writing to them changes the record.
    """

    def __init__(self, message: type[M]) -> None:
        schema = message.schema
        self._size = schema.size - len(ENCAPSULATION)
        self._seed = schema.seed
        self._memory = np.zeros(_BODY_START + schema.record_dtype.itemsize, dtype=np.uint8)
        self._memory[_BODY_START - len(ENCAPSULATION) : _BODY_START] = list(ENCAPSULATION)
        self.records: StructArray = self._memory[_BODY_START:].view(schema.record_dtype)
        self.record: M = view_struct(self.records)
        self._heads = self._memory[_BODY_START : _BODY_START + _HEAD.itemsize].view(_HEAD)
        begin = _BODY_START - len(ENCAPSULATION)
        self.data = self._memory.data[begin : begin + schema.size]

    def seal(self, sender: int, sequence: int, stamp_ns: int) -> bytes:
        """Fill in the head and return the bytes to send."""
        nonce = np.uint64(sender)  # uint64, as numba's int is signed
        seal_message(self._memory, self._heads, self._size, self._seed, nonce, sequence, stamp_ns)
        return self.data.tobytes()

    def fill(self, message: M) -> None:
        """Copy every field of a message object."""
        for name in message.schema.wires:
            setattr(self.record, name, getattr(message, name))
