"""The page of the web view, on loopback, restricted to local connections.

`/` is a page of ours that shows Rerun's viewer in a frame. It asks for `/instance` all the time and
loads the frame again when another view process answers at the same address: so a page that was
left open comes back by itself after a restart. The answer names the newest stamp that was sent;
the page compares it with the newest that the viewer has, says so when that is old, and reports it.

Rerun's viewer loads a font from Google and posts usage statistics to tel.rerun.io from the browser,
whatever the settings here. This server adds a content security policy that restricts both pages to
the data on this machine. The viewer would follow the browser's light or dark theme; the colours of
the view are made for a dark background, so its address asks for the dark one. Its bound of memory
(`memory_limit`) is an option of the viewer that its own page does not take from the address, so
this server adds that; without a bound a page grows to 2.5 GB.
"""

import json
import math
import secrets
import shutil
import sys
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from collections import deque
from collections.abc import Callable
from http.client import HTTPResponse
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Self

from teleop.view.ports import LOOPBACK

_HERE = Path(__file__).parent
_VIEWER = "/viewer.html"
_OURS = {  # path -> file, content type
    "/": ("page.html", "text/html; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
}
_VIEWERS = {  # path -> path at the viewer program
    "/re_viewer.js": "/re_viewer.js",
    "/re_viewer_bg.wasm": "/re_viewer_bg.wasm",
    "/favicon.ico": "/favicon.ico",
}
_MARK = b'hide_welcome_screen: query.has("hide_welcome_screen"),'  # in the viewer's own page
_REPORTED_S = 3.0  # [s] for which a page's report counts; it comes twice a second
_PASSED_ON = ("Content-Type", "Content-Length", "rerun-final-length")


class Page:
    """Serves the viewer's page from its start until `close`.

    Parameters
    ----------
    port : int
        Where to serve it; raises `OSError` if that is taken.
    source_port : int
        Where the viewer program serves its files, on loopback.
    data_url : str
        `rerun+http://...`, where the page is to find its data.
    memory_mb : int
        [MB] memory of the viewer in the browser, beyond which it drops the oldest data.
    """

    def __init__(self, port: int, source_port: int, data_url: str, memory_mb: int) -> None:
        data_address = urllib.parse.urlsplit(data_url.removeprefix("rerun+")).netloc
        query = urllib.parse.urlencode(
            {"url": data_url, "theme": "dark", "hide_welcome_screen": ""}
        )
        self.newest_ns: Callable[[], int] = lambda: 0  # [ns] the newest stamp sent, 0: unknown
        self._reports: deque[tuple[float, float]] = deque(
            maxlen=100
        )  # [s] when, and how far behind
        instance = {"instance": secrets.token_hex(8), "query": query}

        def looked(behind_s: float) -> bytes:
            if math.isfinite(behind_s):
                self._reports.append((time.monotonic(), behind_s))
            return json.dumps(instance | {"newest_s": self.newest_ns() * 1e-9}).encode()

        class Handler(_Handler):
            source = f"http://{LOOPBACK}:{source_port}"
            answer = staticmethod(looked)
            limit = memory_mb
            policy = (
                f"default-src 'self'; connect-src 'self' http://{data_address}; "
                "script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; "
                "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
                "worker-src 'self' blob:; frame-ancestors 'self'; form-action 'none'"
            )

        self._server = _Server((LOOPBACK, port), Handler)
        self.address = f"http://{LOOPBACK}:{self._server.server_port}/"
        self._thread = threading.Thread(target=self._server.serve_forever, name="page", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def behind_s(self) -> float:
        """Return how far [s] the slowest of the open pages is behind what was sent."""
        since = time.monotonic() - _REPORTED_S
        return max(
            (behind_s for when, behind_s in list(self._reports) if when > since), default=0.0
        )

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False  # do not wait for open connections of a browser

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of a browser that disconnected, which is no error."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    source = ""
    policy = ""
    answer: Callable[[float], bytes] = staticmethod(lambda _: b"")
    limit = 0  # [MB]
    timeout = 60

    def do_GET(self) -> None:
        """Serve one of our files, the instance, or one of the viewer's files."""
        path = urllib.parse.urlsplit(self.path).path
        if path in _OURS:
            name, kind = _OURS[path]
            self._answer((_HERE / name).read_bytes(), kind)
        elif path == "/instance":
            self._answer(self.answer(self._behind_s()), "application/json")
        elif path == _VIEWER:
            self._bound()
        elif path in _VIEWERS:
            self._pass_on(_VIEWERS[path])
        else:
            self.send_error(404)

    def _behind_s(self) -> float:
        """Return how far [s] the page that asks says it is behind; NaN if it does not."""
        query = urllib.parse.parse_qs(urllib.parse.urlsplit(self.path).query)
        try:
            return float(query["behind"][0])
        except (KeyError, ValueError):
            return math.nan

    def _answer(self, content: bytes, kind: str) -> None:
        headers = {"Content-Type": kind, "Content-Length": str(len(content))}
        self._begin(headers | {"Cache-Control": "no-store"})
        self.wfile.write(content)

    def _bound(self) -> None:
        """Send the viewer's page, with a bound of its memory."""
        if answer := self._ask("/"):
            with answer:
                content = answer.read()
            limit = f' memory_limit: "{self.limit}MB",'.encode()
            self._answer(content.replace(_MARK, _MARK + limit), _OURS["/"][1])

    def _ask(self, path: str) -> HTTPResponse | None:
        """Return what the viewer program answers for `path`, or answer that it does not."""
        try:
            answer: HTTPResponse = urllib.request.urlopen(self.source + path, timeout=30)  # noqa: S310 - http only
        except (urllib.error.URLError, OSError):
            self.send_error(502, "the viewer program does not answer")
            return None
        return answer

    def _pass_on(self, path: str) -> None:
        """Send what the viewer program answers for `path`."""
        answer = self._ask(path)
        if answer is None:
            return
        with answer:
            self._begin({n: answer.headers[n] for n in _PASSED_ON if n in answer.headers})
            shutil.copyfileobj(answer, self.wfile, 1 << 20)

    def _begin(self, headers: dict[str, str]) -> None:
        self.send_response(200)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("Content-Security-Policy", self.policy)
        self.send_header("Referrer-Policy", "no-referrer")
        self.end_headers()

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the base class's name
        """Do not log to the terminal."""
