"""What becomes of a message, as a pure function.

A stream is one topic in one direction. The fate of its k-th message is drawn from numbers that
depend on the stream's key and on k alone, always the same ones for the same purpose. So two runs
of one seed lose the same messages whatever their timing, and asking for corruption as well does not
change which ones are lost.
"""

import hashlib
import math
from enum import IntFlag
from typing import NamedTuple

from teleop.impair.config import DirectionConfig

_MASK = (1 << 64) - 1
_GOLDEN = 0x9E3779B97F4A7C15  # increment of SplitMix64
_LOSS, _BURST, _BURST_LOSS, _REORDER, _DUPLICATE, _CORRUPT, _PLACE, _VALUE, _JITTER = range(9)
_DRAWS = 16  # numbers set aside for each message
_KNOT = 1 << 60  # where the numbers of a wandering delay begin


class Fate(IntFlag):
    """What was done to a message; 0 = delivered once, unchanged, in its turn."""

    PASSED = 0
    CUT = 1
    LOST = 2
    LOST_IN_BURST = 4
    CORRUPTED = 8
    DUPLICATED = 16
    HELD_BACK = 32


class StreamState(NamedTuple):
    """All that a stream remembers from one message to the next."""

    number: int = 0  # of messages so far
    bad: bool = False  # the state of the Gilbert-Elliott channel
    due: float = -math.inf  # [s] when the last message that keeps its turn is delivered


class Delivery(NamedTuple):
    """Bytes to be handed on, and when [s]."""

    due: float
    data: bytes


def key_of(seed: int, *names: str) -> int:
    """Return the key of a stream."""
    text = "/".join([str(seed), *names]).encode()
    return int.from_bytes(hashlib.blake2b(text, digest_size=8).digest(), "little")


def uniform(key: int, number: int) -> float:
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
) -> tuple[tuple[Delivery, ...], Fate, StreamState]:
    """Decide on the next message of a stream.

    Parameters
    ----------
    config : DirectionConfig
        What may happen to it.
    key : int
        The stream's, see `key_of`.
    time_s : float
        When it came [s]; never decreasing.
    data : bytes
        The message.
    cut : bool
        Whether the direction is cut at this moment, on command; `config.cuts` are besides.

    Returns
    -------
    deliveries, fate, memory
        A message is delivered within [delay - jitter, delay + jitter] of its coming, and never
        before one that came earlier; one that is held back, `reorder_by` later than that.
    """
    first = memory.number * _DRAWS

    def chance(purpose: int, share: float) -> bool:
        return share > 0.0 and uniform(key, first + purpose) < share

    turn = config.burst_leave if memory.bad else config.burst_enter
    bad = memory.bad != chance(_BURST, turn) and config.burst_loss > 0.0
    due = max(time_s + delay(config, key, memory.number, time_s), memory.due)
    fate = Fate.PASSED
    if cut or config.cut_at(time_s):
        fate = Fate.CUT
    elif bad and chance(_BURST_LOSS, config.burst_depth):
        fate = Fate.LOST_IN_BURST
    elif chance(_LOSS, config.loss):
        fate = Fate.LOST
    if fate:
        return (), fate, StreamState(memory.number + 1, bad, memory.due)
    after = StreamState(memory.number + 1, bad, due)
    if chance(_CORRUPT, config.corrupt) and data:
        fate |= Fate.CORRUPTED
        place = int(uniform(key, first + _PLACE) * len(data))
        other = data[place] ^ (1 + int(uniform(key, first + _VALUE) * 255))
        data = data[:place] + bytes([other]) + data[place + 1 :]
    if chance(_REORDER, config.reorder):
        fate |= Fate.HELD_BACK
        due += config.reorder_by  # and nobody waits for it
    copies = 1
    if chance(_DUPLICATE, config.duplicate):
        fate |= Fate.DUPLICATED
        copies = 2
    return (Delivery(due, data),) * copies, fate, after


def delay(config: DirectionConfig, key: int, number: int, time_s: float) -> float:
    """Return by how much [s] the `number`-th message of a stream, which came at `time_s`, is late.

    With `jitter_time` the delay moves in straight lines between values drawn that far apart, as
    queues of a network fill and empty. Without, each message has one of its own; as none overtakes
    another, a fast stream then has nearly the longest delay throughout.
    """
    if not config.jitter:
        return config.delay
    if config.jitter_time:
        knot, part = divmod(time_s / config.jitter_time, 1.0)
        a, b = (uniform(key, _KNOT + int(knot) + end) for end in (0, 1))
        share = a + (b - a) * part
    else:
        share = uniform(key, number * _DRAWS + _JITTER)
    return config.delay + config.jitter * (2.0 * share - 1.0)
