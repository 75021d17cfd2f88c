"""The page of the web view, on loopback, kept from talking to anyone else.

Rerun's page loads a font from Google and posts usage statistics to tel.rerun.io from the browser,
whatever the settings here. This server hands on the page under a content security policy that lets
it reach the data on this machine and nothing more; the browser enforces it.
"""

import shutil
import threading
import urllib.error
import urllib.parse
import urllib.request
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Self

from teleop.view.viewer_process import LOOPBACK

_FILES = {"/", "/index.html", "/re_viewer.js", "/re_viewer_bg.wasm", "/favicon.ico"}
_PASSED_ON = ("Content-Type", "Content-Length", "rerun-final-length")


class Page:
    """Serves the viewer's page from its start until `close`.

    Parameters
    ----------
    port : int
        First choice; a free port is taken if it is in use.
    source_port : int
        Where the viewer program serves the same files, on loopback.
    data_url : str
        `rerun+http://...`, where the page is to find its data.
    """

    def __init__(self, port: int, source_port: int, data_url: str) -> None:
        data_address = urllib.parse.urlsplit(data_url.removeprefix("rerun+")).netloc

        class Handler(_Handler):
            source = f"http://{LOOPBACK}:{source_port}"
            policy = (
                f"default-src 'self'; connect-src 'self' http://{data_address}; "
                "script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; "
                "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; "
                "worker-src 'self' blob:; frame-ancestors 'none'; form-action 'none'"
            )

        try:
            self._server = _Server((LOOPBACK, port), Handler)
        except OSError:
            self._server = _Server((LOOPBACK, 0), Handler)
        query = urllib.parse.urlencode({"url": data_url, "hide_welcome_screen": ""})
        self.address = f"http://{LOOPBACK}:{self._server.server_port}/?{query}"
        self._thread = threading.Thread(target=self._server.serve_forever, name="page", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop serving."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False  # a browser that keeps its connection open does not hold us back


class _Handler(BaseHTTPRequestHandler):
    source = ""
    policy = ""
    timeout = 60

    def do_GET(self) -> None:
        """Hand on one of the viewer's files."""
        path = urllib.parse.urlsplit(self.path).path
        if path not in _FILES:
            self.send_error(404)
            return
        try:
            answer = urllib.request.urlopen(self.source + path, timeout=30)  # noqa: S310 - http only
        except (urllib.error.URLError, OSError):
            self.send_error(502, "the viewer program does not answer")
            return
        with answer:
            self.send_response(200)
            for name in _PASSED_ON:
                if answer.headers.get(name) is not None:
                    self.send_header(name, answer.headers[name])
            self.send_header("Content-Security-Policy", self.policy)
            self.send_header("Referrer-Policy", "no-referrer")
            self.end_headers()
            try:
                shutil.copyfileobj(answer, self.wfile, 1 << 20)
            except (BrokenPipeError, ConnectionResetError):
                self.close_connection = True  # the browser went away

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the base class's name
        """Say nothing: the terminal belongs to the session."""
