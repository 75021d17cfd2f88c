"""The page of the web view, for the user whose process serves it alone (`LocalServer`).

`/` is a page of ours that shows Rerun's viewer in a frame and feeds it: it asks for `blocks` all
the time, gets Rerun's messages that came since, the newest first where there are many, and asks for
older ones once it is current. While some are missing, its questions for newer ones do not wait, so
that the past of a recording comes as fast as the page takes it. So the data reach a browser by the
same address, secret and checks as the page, nothing can be written to them, and a slow page has the
present before the past. A page that was left open comes back by itself when another view process
answers at its address. With each question it says how far what it shows is behind.

Rerun's viewer loads a font from Google and posts usage statistics to tel.rerun.io from the browser,
whatever the settings here. This server adds a content security policy that restricts both pages to
this server. The viewer would follow the browser's light or dark theme; the colours of the view are
made for a dark background, so its address asks for the dark one. Its bound of memory
(`memory_limit`) is an option of the viewer that its own page does not take from the address, so
this server adds that; without a bound a page grows to 2.5 GB.
"""

import json
import math
import secrets
import socket
import struct
import threading
import time
import urllib.parse
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from teleop.view.local_server import GuardedHandler, LocalServer

# --- Rerun's messages as the page takes them: split, bounded in memory, newest first
# A block that Rerun encodes is a header of 12 bytes, then messages with a header of 16 bytes each
# (kind and size), then an index that is of no use here. Of each message is known whether it must be
# kept for ever (what describes the recording, its layout, static data) or may be dropped when old.


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

    Raises `RrdError` if it is none.
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

    Of the rest `limit` [bytes] are kept, for pages opened later.
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

    def read_newer(self, than: int, wait_s: float) -> PageMessages:
        """Return what came after a block, of much the newest; waits `wait_s` [s] for any."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest > than or self._closed, wait_s)
            kept = [content for number, content in self._kept if number > than]
            return self._select_blocks(than, self._newest, kept)

    def read_older(self, than: int, down_to: int) -> PageMessages:
        """Return the newest of the data between two blocks that may be dropped, both excluded."""
        with self._changed:
            return self._select_blocks(down_to, than - 1, [])

    def _select_blocks(self, low: int, high: int, kept: list[bytes]) -> PageMessages:
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


_HERE = Path(__file__).parent
_HTML, _BINARY = "text/html; charset=utf-8", "application/octet-stream"
_OWN_FILES = {  # path -> file, content type
    "": ("page.html", _HTML),
    "page.js": ("page.js", "text/javascript; charset=utf-8"),
}
VIEWER_FILES = {  # path -> path at the viewer program, content type
    "viewer.html": ("/", _HTML),
    "re_viewer.js": ("/re_viewer.js", "text/javascript"),
    "re_viewer_bg.wasm": ("/re_viewer_bg.wasm", "application/wasm"),
    "favicon.ico": ("/favicon.ico", "image/x-icon"),
}
_MARK = b'hide_welcome_screen: query.has("hide_welcome_screen"),'  # in the viewer's own page
_REPORT_LIFE_S = 3.0  # [s] for which a page's report counts
_WAIT_S = 1.0  # [s] that a page waits for new data
_GOODBYE_S = 2.0 * _WAIT_S  # [s] in which open pages are told that it is over
_POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
    "worker-src 'self' blob:; frame-ancestors 'self'; form-action 'none'"
)


class Page:
    """Serves the viewer's page from its start until `close`.

    `port` and `secret` are as of `LocalServer`, `files` the viewer's own by the keys of
    `VIEWER_FILES`; beyond `memory_mb` [MB] the viewer in the browser drops the oldest data.
    """

    def __init__(
        self,
        port: int | socket.socket,
        secret: str,
        files: Mapping[str, bytes],
        blocks: BlockBuffer,
        memory_mb: int,
    ) -> None:
        self.newest_ns: Callable[[], int] = lambda: 0  # [ns] the newest stamp sent, 0: unknown
        self.light: Callable[[], bytes] = lambda: b""  # the layout for a page that draws slowly
        self.layout: Callable[[], int] = lambda: 0  # counts the layouts that were sent
        self._reports: deque[tuple[float, float]] = deque(maxlen=100)  # [s] when, how far behind
        self._blocks = blocks
        self._instance = secrets.token_hex(8)
        self._ended = ""
        # page -> [s] when it asked last; told of the end: gone
        self._waiting: dict[str, float] = {}
        limit = f' memory_limit: "{memory_mb}MB",'.encode()
        self._files = dict(files)
        self._files["viewer.html"] = files["viewer.html"].replace(_MARK, _MARK + limit)

        class Handler(_Handler):
            page = self

        self._server = LocalServer(Handler, port, secret)
        self.address = f"http://{self._server.address}"

    def close(self, ended: str = "The view was closed.") -> None:
        """Tell open pages that it is over, and stop serving."""
        self._ended = ended
        self._blocks.close()
        end = time.monotonic() + _GOODBYE_S
        while (now := time.monotonic()) < end and any(
            asked > now - _GOODBYE_S for asked in list(self._waiting.values())
        ):
            time.sleep(0.02)
        self._server.close()

    def get_delay_s(self) -> float:
        """Return how far [s] the slowest of the open pages is behind what was sent."""
        since = time.monotonic() - _REPORT_LIFE_S
        return max(
            (behind_s for when, behind_s in list(self._reports) if when > since), default=0.0
        )

    def read_file(self, path: str) -> tuple[bytes, str] | None:
        """Return a file and its type; None if there is none of this name."""
        if path in _OWN_FILES:
            name, kind = _OWN_FILES[path]
            return (_HERE / name).read_bytes(), kind
        if path in self._files:
            return self._files[path], VIEWER_FILES[path][1]
        return (self.light(), _BINARY) if path == "light.rbl" else None

    def take_blocks(self, query: Mapping[str, str]) -> tuple[PageMessages, dict[str, object]]:
        """Return what a page asks for, and what it must know.

        Raises `ValueError` if the question has no such form.
        """
        newer, older = int(query.get("newer", -1)), int(query.get("older", 0))
        behind_s, wait_s = float(query.get("behind", "nan")), float(query.get("wait", _WAIT_S))
        if math.isfinite(behind_s):
            self._reports.append((time.monotonic(), behind_s))
        page = query.get("page", "")[:32]
        if page:
            self._waiting[page] = time.monotonic()
        answer = (
            self._blocks.read_older(older, newer)
            if older
            else self._blocks.read_newer(newer, min(wait_s, _WAIT_S))
        )
        said = {
            "instance": self._instance,
            "oldest": answer.oldest,
            "newest": answer.newest,
            "newest_s": self.newest_ns() * 1e-9,
            "layout": self.layout(),
            "ended": "" if answer.content else self._ended,
        }
        if said["ended"]:
            self._waiting.pop(page, None)
        elif len(self._waiting) > 100:
            self._waiting.clear()
        return answer, said


class _Handler(GuardedHandler):
    page: Page

    def answer(self, path: str) -> None:
        """Send messages of Rerun, or a file."""
        if path == "blocks":
            query = dict(urllib.parse.parse_qsl(urllib.parse.urlsplit(self.path).query))
            try:
                answer, said = self.page.take_blocks(query)
            except ValueError:
                self.send_error(400)
                return
            self._send(answer.content, _BINARY, {"X-View": json.dumps(said)})
        elif (file := self.page.read_file(path)) is not None:
            self._send(*file, {})
        else:
            self.send_error(404)

    def _send(self, content: bytes, kind: str, headers: dict[str, str]) -> None:
        self.send_response(200)
        for name, value in {
            "Content-Type": kind,
            "Content-Length": str(len(content)),
            "rerun-final-length": str(len(content)),  # the viewer's page shows its progress
            "Cache-Control": "no-store",
            "Content-Security-Policy": _POLICY,
            "Cross-Origin-Resource-Policy": "same-origin",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
            **headers,
        }.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)
