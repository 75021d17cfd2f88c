"""The page of the web view, for the user whose process serves it alone (`LocalServer`).

`/` is a page of ours that shows Rerun's viewer in a frame and feeds it: it asks for `blocks` all
the time, gets Rerun's messages that came since, the newest first where there are many, and asks for
older ones once it is current. So the data reach a browser by the same address, secret and checks as
the page, nothing can be written to them, and a slow page has the present before the past. A page
that was left open comes back by itself when another view process answers at its address. With each
question it says how far what it shows is behind.

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
import time
import urllib.parse
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path

from teleop.view.local_server import GuardedHandler, LocalServer
from teleop.view.rrd import BlockBuffer, PageMessages

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

    Parameters
    ----------
    port : int or socket
        Preferred port, or a socket that listens.
    secret : str
        Of the address; "" makes one.
    files : mapping of str to bytes
        The viewer's own files, by the keys of `VIEWER_FILES`.
    blocks : Blocks
        What it shows.
    memory_mb : int
        [MB] memory of the viewer in the browser, beyond which it drops the oldest data.
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
        self._waiting: dict[
            str, float
        ] = {}  # page -> [s] when it asked last; told of the end: gone
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
        while self._listening() and time.monotonic() < end:
            time.sleep(0.02)
        self._server.close()

    def _listening(self) -> bool:
        since = time.monotonic() - _GOODBYE_S
        return any(asked > since for asked in list(self._waiting.values()))

    def behind_s(self) -> float:
        """Return how far [s] the slowest of the open pages is behind what was sent."""
        since = time.monotonic() - _REPORT_LIFE_S
        return max(
            (behind_s for when, behind_s in list(self._reports) if when > since), default=0.0
        )

    def content(self, path: str) -> tuple[bytes, str] | None:
        """Return a file and its type; None if there is none of this name."""
        if path in _OWN_FILES:
            name, kind = _OWN_FILES[path]
            return (_HERE / name).read_bytes(), kind
        if path in self._files:
            return self._files[path], VIEWER_FILES[path][1]
        return (self.light(), _BINARY) if path == "light.rbl" else None

    def take_blocks(self, query: Mapping[str, str]) -> tuple[PageMessages, dict[str, object]]:
        """Return what a page asks for, and what it must know.

        Raises
        ------
        ValueError
            The question has no such form.
        """
        newer, older = int(query.get("newer", -1)), int(query.get("older", 0))
        behind_s = float(query.get("behind", "nan"))
        if math.isfinite(behind_s):
            self._reports.append((time.monotonic(), behind_s))
        page = query.get("page", "")[:32]
        if page:
            self._waiting[page] = time.monotonic()
        answer = self._blocks.older(older, newer) if older else self._blocks.newer(newer, _WAIT_S)
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
        elif (file := self.page.content(path)) is not None:
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
