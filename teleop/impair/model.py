"""The impairment of a message, as a pure function.

A stream is one topic in one direction. The random numbers of its k-th message depend only on the
stream's key, k and their purpose. So two runs with one seed lose the same messages for any timing,
and enabling corruption does not change which ones are lost.
"""

import hashlib
import math
from enum import IntFlag
from typing import NamedTuple

from teleop.impair.config import DirectionConfig

_MASK = (1 << 64) - 1
_GOLDEN = 0x9E3779B97F4A7C15  # increment of SplitMix64
_LOSS, _BURST, _BURST_LOSS, _REORDER, _DUPLICATE, _CORRUPT, _PLACE, _VALUE, _JITTER = range(9)
_DRAWS_PER_MESSAGE = 16  # random numbers per message
_DELAY_DRAW_OFFSET = 1 << 60  # offset of the random numbers of the delay


class DeliveryFlags(IntFlag):
    """Impairments of a message; 0 = delivered once, unchanged, in order."""

    PASSED = 0
    CUT = 1
    LOST = 2
    LOST_IN_BURST = 4
    CORRUPTED = 8
    DUPLICATED = 16
    HELD_BACK = 32


class StreamState(NamedTuple):
    """State of a stream between messages."""

    number: int = 0  # of messages so far
    bad: bool = False  # the state of the Gilbert-Elliott channel
    due: float = -math.inf  # [s] delivery time of the last message in order


class Delivery(NamedTuple):
    """Bytes to be delivered, and their time [s]."""

    due: float
    data: bytes


def compute_key(seed: int, *names: str) -> int:
    """Return the key of a stream."""
    text = "/".join([str(seed), *names]).encode()
    return int.from_bytes(hashlib.blake2b(text, digest_size=8).digest(), "little")


def draw_uniform(key: int, number: int) -> float:
    """Return the `number`-th random number of a key, within [0, 1).

    SplitMix64 (Steele, Lea & Flood 2014), whose k-th output is a function of k.
    """
    z = (key + (number + 1) * _GOLDEN) & _MASK
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & _MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & _MASK
    return ((z ^ (z >> 31)) >> 11) * 2.0**-53


def step(
    config: DirectionConfig,
    key: int,
    memory: StreamState,
    time_s: float,
    data: bytes,
    cut: bool = False,
) -> tuple[tuple[Delivery, ...], DeliveryFlags, StreamState]:
    """Process the next message of a stream.

    `key` is that of the stream (`compute_key`); `time_s` [s], of arrival, never decreases; `cut` is
    by command, in addition to `config.cuts`. A message is delivered within [delay - jitter, delay +
    jitter] of its arrival, in order; one held back, `reorder_by` later.
    """
    first = memory.number * _DRAWS_PER_MESSAGE

    def chance(purpose: int, share: float) -> bool:
        return share > 0.0 and draw_uniform(key, first + purpose) < share

    turn = config.burst_leave if memory.bad else config.burst_enter
    is_bad = memory.bad != chance(_BURST, turn) and config.burst_loss > 0.0
    due = max(time_s + compute_delay(config, key, memory.number, time_s), memory.due)
    flags = DeliveryFlags.PASSED
    if cut or config.cut_at(time_s):
        flags = DeliveryFlags.CUT
    elif is_bad and chance(_BURST_LOSS, config.burst_depth):
        flags = DeliveryFlags.LOST_IN_BURST
    elif chance(_LOSS, config.loss):
        flags = DeliveryFlags.LOST
    if flags:
        return (), flags, StreamState(memory.number + 1, is_bad, memory.due)
    new_state = StreamState(memory.number + 1, is_bad, due)
    if chance(_CORRUPT, config.corrupt) and data:
        flags |= DeliveryFlags.CORRUPTED
        index = int(draw_uniform(key, first + _PLACE) * len(data))
        corrupted = data[index] ^ (1 + int(draw_uniform(key, first + _VALUE) * 255))
        data = data[:index] + bytes([corrupted]) + data[index + 1 :]
    if chance(_REORDER, config.reorder):
        flags |= DeliveryFlags.HELD_BACK
        due += config.reorder_by  # and nobody waits for it
    copies = 1
    if chance(_DUPLICATE, config.duplicate):
        flags |= DeliveryFlags.DUPLICATED
        copies = 2
    return (Delivery(due, data),) * copies, flags, new_state


def compute_delay(config: DirectionConfig, key: int, number: int, time_s: float) -> float:
    """Return the delay [s] of the `number`-th message of a stream, received at `time_s`.

    With `jitter_time` the delay is linear between random values that far apart, like the filling of
    network queues. Without, each message has its own; as order is kept, a fast stream then has
    nearly the longest delay.
    """
    if not config.jitter:
        return config.delay
    if config.jitter_time:
        knot, part = divmod(time_s / config.jitter_time, 1.0)
        a, b = (draw_uniform(key, _DELAY_DRAW_OFFSET + int(knot) + end) for end in (0, 1))
        share = a + (b - a) * part
    else:
        share = draw_uniform(key, number * _DRAWS_PER_MESSAGE + _JITTER)
    return config.delay + config.jitter * (2.0 * share - 1.0)
