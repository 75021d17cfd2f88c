"""Rerun's messages as the page takes them: split, bounded in memory, newest first.

A block that Rerun encodes is a header of 12 bytes, then messages with a header of 16 bytes each
(kind and size), then an index that is of no use here. Of each message is known whether it must be
kept for ever (what describes the recording, its layout, static data) or may be dropped when old.
"""

import struct
import threading
from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

_STREAM = 12  # [bytes] of the header of a stream
_MESSAGE = struct.Struct("<QQ")  # kind, size
_END, _DATA = 0, 2  # kinds: of the index, of data
_RECORDING_STORE = b"\x08\x01"  # a message's store id (field 1) > kind (field 1): not a layout
_STATIC = b"\x38\x01"  # the last field of data: is_static (7)
_ANSWER = 400_000  # [bytes] of old data in one answer at most


class RrdError(ValueError):
    """Bytes that are no messages of Rerun."""


class EncodedMessage(NamedTuple):
    """An encoded message with its header."""

    content: bytes
    kept: bool  # for pages that are opened at any later time


def read_stream_header(block: bytes) -> bytes:
    """Return the header of an encoded block, with which a stream begins."""
    return block[:_STREAM]


def split_messages(block: bytes) -> Iterator[EncodedMessage]:
    """Yield the messages of an encoded block, without the index at its end.

    Raises
    ------
    RrdError
        It is none.
    """
    if block[:3] != b"RRF" or len(block) < _STREAM:
        raise RrdError("no header of a Rerun stream")
    at = _STREAM
    while at + _MESSAGE.size <= len(block):
        kind, size = _MESSAGE.unpack_from(block, at)
        end = at + _MESSAGE.size + size
        if kind == _END:
            return
        if kind > 3 or end > len(block):  # the last one of a killed program is cut
            if at == _STREAM:
                raise RrdError("no message of Rerun at the begin")
            return
        store = at + _MESSAGE.size + 2  # after the tag and the size of the store id
        temporal = kind == _DATA and block[store : store + 2] == _RECORDING_STORE
        kept = not temporal or block[end - 2 : end] == _STATIC
        yield EncodedMessage(block[at:end], kept)
        at = end


def split_block(block: bytes, size: int) -> Iterator[bytes]:
    """Yield an encoded block as blocks of about `size` [bytes]; `RrdError` if it is none."""
    held: list[bytes] = []
    for message in split_messages(block):
        held.append(message.content)
        if sum(map(len, held)) >= size:
            yield read_stream_header(block) + b"".join(held)
            held = []
    if held:
        yield read_stream_header(block) + b"".join(held)


class PageMessages(NamedTuple):
    """Messages for a page."""

    content: bytes  # a whole stream; empty if there are none
    oldest: int  # number of the oldest block that may be dropped in it
    newest: int  # number of the newest block that it has, or that was there


class BlockBuffer:
    """Numbered blocks of messages for pages: what must be kept, and the newest of the rest.

    Parameters
    ----------
    limit : int
        [bytes] of data that are kept for pages opened later.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._header = b""
        self._kept: list[tuple[int, bytes]] = []
        self._recent: deque[tuple[int, bytes]] = deque()
        self._size = 0
        self._newest = 0
        self._changed = threading.Condition()
        self._closed = False

    def add(self, block: bytes) -> None:
        """Add an encoded block; `RrdError` if it is none."""
        messages = list(split_messages(block))
        kept = b"".join(message.content for message in messages if message.kept)
        recent = b"".join(message.content for message in messages if not message.kept)
        with self._changed:
            self._header = self._header or read_stream_header(block)
            self._newest += 1
            if kept:
                self._kept.append((self._newest, kept))
            if recent:
                self._recent.append((self._newest, recent))
                self._size += len(recent)
            while self._size > self._limit and len(self._recent) > 1:
                self._size -= len(self._recent.popleft()[1])
            self._changed.notify_all()

    def close(self) -> None:
        """Let nobody wait any longer: no more will come."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def newer(self, than: int, wait_s: float) -> PageMessages:
        """Return what came after a block, of much the newest; waits `wait_s` [s] for any."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest > than or self._closed, wait_s)
            return self._answer(than, self._newest, self._kept_after(than))

    def older(self, than: int, down_to: int) -> PageMessages:
        """Return the newest of the data between two blocks that may be dropped, both excluded."""
        with self._changed:
            return self._answer(down_to, than - 1, [])

    def _kept_after(self, number: int) -> list[bytes]:
        return [content for n, content in self._kept if n > number]

    def _answer(self, low: int, high: int, kept: list[bytes]) -> PageMessages:
        """Return what is kept, and the newest of the blocks in (low, high] that fit."""
        chosen: list[bytes] = []
        oldest, size = high + 1, 0
        for number, content in reversed(self._recent):
            if number <= low or (chosen and size + len(content) > _ANSWER):
                break
            if number <= high:
                chosen.append(content)
                oldest, size = number, size + len(content)
        body = b"".join([*kept, *reversed(chosen)])
        return PageMessages(self._header + body if body else b"", oldest, max(high, low))
