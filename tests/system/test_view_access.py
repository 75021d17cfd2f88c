"""Who may look at a live view: its user by the printed address, and nobody else.

Each stranger is given more than he would have, the whole address with its secret where he can use
it, and must get nothing, and nothing of his may get into what is shown.
"""

import http.client
import json
import shutil
import socket
import subprocess
import sys
import threading
import urllib.parse
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest

from studies.testbed import browser
from studies.testbed.processes import wait_for_condition
from teleop.view.columns import decode
from teleop.view.foxglove_server import FoxgloveServer
from teleop.view.scene import Scene
from teleop.view.sinks import Sink
from tests.teleop.view.made_session import CONFIG, Session

NOBODY = 65534
WRITES = (
    "/rerun.sdk_comms.v1alpha1.MessageProxyService/WriteMessages",
    "/rerun.sdk_comms.v1alpha1.MessageProxyService/WriteTable",
)
READS = ("/rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages", "/proxy", "/")

# what a page of another site tries with an address: the outcome of each attempt
ATTEMPTS = """
const done = {};
const tag = (name, make) => new Promise((resolve) => {
  const element = document.createElement(name);
  element.onload = () => resolve("loaded");
  element.onerror = () => resolve("refused");
  make(element);
  document.body.append(element);
  setTimeout(() => resolve("refused"), 8000);
});
const read = async (options) => {
  const answer = await fetch(address + "blocks", options);
  return (await answer.arrayBuffer()).byteLength > 0 ? "read" : "refused";
};
(async () => {
  done.cors = await read({}).catch(() => "refused");
  done.opaque = await read({ mode: "no-cors" }).catch(() => "refused");
  done.posted = await read({ method: "POST", mode: "no-cors", body: "x" }).catch(() => "refused");
  done.script = await tag("script", (e) => { e.src = address + "page.js"; });
  done.image = await tag("img", (e) => { e.src = address + "favicon.ico"; });
  done.style = await tag("link", (e) => { e.rel = "stylesheet"; e.href = address + "page.js"; });
  const frame = document.createElement("iframe");
  frame.src = address;
  document.body.append(frame);
  await new Promise((resolve) => setTimeout(resolve, 2000));
  try { done.frame = frame.contentWindow.document.body.innerText ? "read" : "refused"; }
  catch { done.frame = "refused"; }
  const opened = window.open(address);
  await new Promise((resolve) => setTimeout(resolve, 2000));
  try { done.opened = opened && opened.document.body.innerText ? "read" : "refused"; }
  catch { done.opened = "refused"; }
  done.socket = await new Promise((resolve) => {
    const socket = new WebSocket(app, ["foxglove.sdk.v1"]);
    socket.onmessage = () => resolve("read");
    socket.onerror = () => resolve("refused");
  });
  document.title = JSON.stringify(done);
})();
"""


@pytest.fixture(scope="module")
def view():
    """A view that shows something: its address."""
    with Sink("web", CONFIG, "test", None, live=True) as sink:
        scene = Scene(CONFIG, sink.stream, sink.lay_out)
        scene.send(decode(Session(0.5).messages))
        sink.publish()
        yield urllib.parse.urlsplit(sink.lines[0].removeprefix("Web view: "))


def ask(view, method="GET", path=None, host=None, body=None, **headers):
    """Return the status of an answer; `host` is the name under which the server is addressed."""
    connection = http.client.HTTPConnection(view.hostname, view.port, timeout=10)
    try:
        asked = {"Host": host or view.netloc} | {k.replace("_", "-"): v for k, v in headers.items()}
        connection.request(method, path or f"{view.path}blocks", body, asked)
        return connection.getresponse().status
    finally:
        connection.close()


def test_the_printed_address_is_answered(view):
    assert ask(view) == 200
    opened = {"Sec_Fetch_Mode": "navigate", "Sec_Fetch_Dest": "document"}
    assert ask(view, path=view.path, Sec_Fetch_Site="cross-site", **opened) == 200  # by a link
    assert ask(view, host=f"localhost:{view.port}") == 200
    assert ask(view, host="127.0.0.1:1234") == 200  # a tunnel with another number


def test_without_the_secret_nothing_is_answered(view):
    for path in (*READS, "/blocks", "/AAAAAAAAAAAAAAAAAAAAAA/blocks"):
        assert ask(view, path=path) == 403


@pytest.mark.parametrize(
    "asked",
    [
        {"host": "rebound.example"},
        {"host": "rebound.example:9090"},
        {"host": "127.0.0.1.rebound.example:9090"},
        {"host": "0.0.0.0:9090"},
        {"Origin": "https://evil.example"},
        {"Origin": "http://127.0.0.1:8000"},
        {"Origin": "null"},
        {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "no-cors"},
        {"Sec_Fetch_Site": "same-site", "Sec_Fetch_Mode": "cors"},
        {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "navigate", "Sec_Fetch_Dest": "iframe"},
    ],
)
def test_another_name_or_page_is_refused_even_with_the_secret(view, asked):
    assert ask(view, **asked) == 403


def test_two_names_in_one_question_are_refused(view):
    with socket.create_connection((view.hostname, view.port), 10) as stranger:
        names = f"Host: {view.netloc}\r\nHost: evil.example\r\n"
        stranger.sendall(f"GET {view.path}blocks HTTP/1.1\r\n{names}\r\n".encode())
        assert b" 403 " in stranger.recv(1000)


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "PRI"])
def test_nothing_can_be_written(view, method):
    for path in (*WRITES, *(view.path[:-1] + path for path in WRITES)):
        assert ask(view, method, path, body=b"\0\0\0\0\1x") in (403, 405, 501, 505)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not tell whose a socket is")
@pytest.mark.skipif(shutil.which("setpriv") is None, reason="no setpriv")
def test_another_user_is_refused_even_with_the_secret(view):
    script = (
        "import sys, urllib.request\n"
        "print(urllib.request.urlopen(sys.argv[1], timeout=10).status)\n"
    )
    python = shutil.which("python3", path="/usr/bin:/bin") or sys.executable
    words = [python, "-c", script, view.geturl() + "blocks"]
    own = subprocess.run(words, capture_output=True, text=True, check=False)
    assert own.stdout == "200\n", own.stderr
    change = ["setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups"]
    other = subprocess.run([*change, *words], capture_output=True, text=True, check=False)
    if "setresuid failed" in other.stderr or "setgroups failed" in other.stderr:
        pytest.skip("this user cannot become another")
    assert other.returncode != 0
    assert other.stdout == ""


@contextmanager
def other_site(content):
    """Serve a page at another port: another origin."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(content.encode())

        def log_message(self, *_):
            pass

    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


@pytest.mark.skipif(browser.find_program() is None, reason="no Chromium on this machine")
def test_a_page_of_another_site_in_a_real_browser_reads_nothing(view):
    """Of another port here, so it is the same site; it knows both addresses."""
    with FoxgloveServer("demo", 8765) as app, browser.Browser() as page:
        given = f"const address = {json.dumps(view.geturl())}, app = {json.dumps(app.url)};"
        with other_site(f"<body><script>{given}{ATTEMPTS}</script></body>") as address:
            page.open(address)
            assert wait_for_condition(lambda: title(page).startswith("{"), 90, 0.5)
            tried = json.loads(title(page))
        assert set(tried.values()) == {"refused"}, tried
        assert len(tried) == 9
        # the same address works when it is opened
        page.open(view.geturl())
        assert title(page) == "teleop view"


def title(page):
    return page.ask("Runtime.evaluate", expression="document.title")["result"].get("value", "")
