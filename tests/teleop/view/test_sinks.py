import base64
import json
import os
import subprocess
import sys
import time
import urllib.error
import urllib.parse
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from studies.testbed.processes import wait_for_condition
from teleop.errors import TeleopError, UsageError
from teleop.messages.topics import HAND, TENDONS, TOPICS
from teleop.view import sinks
from teleop.view.columns import Sender, decode
from teleop.view.config import ViewConfig, ViewRates
from teleop.view.feed import MessageBuffer, show_recording
from teleop.view.page import BlockBuffer, split_messages
from teleop.view.scene import Scene
from teleop.view.sinks import Sink, disable_usage_statistics
from tests.teleop.recorded import record
from tests.teleop.view.made_session import CONFIG, T0, Session, read, save

# feeding


def test_a_recording_is_shown_whole(session, tmp_path, saved):
    path = record(tmp_path, session.unpack(), delay_ns=1000)
    with Sink("rrd", CONFIG, "demo", tmp_path / "demo.rrd", live=False) as sink:
        fed = show_recording(str(path), Scene(CONFIG, sink.stream), lambda: False, 0.1)
    assert fed.received == len(session.messages)
    again = read(tmp_path / "demo.rrd")
    assert {name for name in again if "__" not in name} == {n for n in saved if "__" not in n}
    last = max(again["/tension/tendon_0/in"]["Scalars:scalars"])
    assert last == session.of(TENDONS)[-1].stamp_ns


def test_a_file_keeps_no_index_of_its_chunks_in_memory(session, tmp_path):
    """Rerun would, as a footer to be written at the end: gigabytes in a session of hours."""
    save(session.messages[:200], tmp_path / "s.rrd")
    with pytest.warns(rr.error_utils.RerunWarning, match="no footer"):
        RrdReader(tmp_path / "s.rrd")


@pytest.mark.parametrize("stretch", [1, 3])
def test_what_waits_comes_out_in_time_and_all_of_it_though_calls_jitter(stretch):
    paced, out = MessageBuffer(0.125, 0.125), []
    paced.stretch = stretch
    for k in range(60):
        paced.add([k])
        out.append(paced.take(k * 125_000_000 + (-1) ** k * 10_000_000))
    out.append(paced.take(0, all_of_it=True))
    assert [k for block in out for k in block] == list(range(60))
    assert sum(bool(block) for block in out) == pytest.approx(60 / stretch, abs=1)


# config


def test_a_topic_shown_more_often_than_its_copies_come_is_received_completely():
    usual, fast = (
        ViewConfig().list_sampled_topics(),
        ViewConfig(rate_hz=ViewRates(hand=101.0)).list_sampled_topics(),
    )
    assert usual == {topic for topic in TOPICS if topic.sampled_hz}
    assert usual - fast == {HAND}


def test_a_window_without_a_screen_is_refused_in_one_line(monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(UsageError, match="use --view web"):
        Sink("native", CONFIG, "test", None, live=True)


def test_a_file_that_cannot_be_written_is_refused_in_one_line(tmp_path):
    (tmp_path / "taken").write_text("")
    with pytest.raises(UsageError, match="cannot be written"):
        Sink("rrd", CONFIG, "test", tmp_path / "taken" / "x.rrd", live=True)


# the web view


@pytest.fixture(scope="module")
def web():
    with Sink("web", CONFIG, "test", None, live=True) as sink:
        yield sink


linux = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")


def address_of(sink):
    return sink.lines[0].removeprefix("Web view: ")


def get(url, **headers):
    """Return status, headers and content of an answer."""
    asked = urllib.request.Request(url, headers=headers)  # noqa: S310
    try:
        with urllib.request.urlopen(asked, timeout=10) as answer:  # noqa: S310
            return answer.status, answer.headers, answer.read()
    except urllib.error.HTTPError as refused:
        with refused:
            return refused.code, refused.headers, refused.read()


def blocks(sink, **query):
    """Return what a page is told, and the messages it gets."""
    status, headers, content = get(f"{address_of(sink)}blocks?{urllib.parse.urlencode(query)}")
    assert status == 200
    return json.loads(headers["X-View"]), content


@linux
def test_the_web_view_is_on_loopback_only_with_a_port_and_secret_of_its_own(web):
    with Sink("web", CONFIG, "test", None, live=True) as second:
        one, other = (urllib.parse.urlsplit(address_of(sink)) for sink in (web, second))
        assert one.hostname == "127.0.0.1"
        assert one.port != other.port
        assert one.path != other.path
        assert len(one.path) >= 22  # 128 bits
    ours = {file.resolve().name for file in Path("/proc/self/fd").iterdir()}
    rows = [
        line.split()
        for table in ("tcp", "tcp6")
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]
    ]
    listening = [row[1] for row in rows if row[3] == "0A" and f"socket:[{row[9]}]" in ours]
    assert f"0100007F:{one.port:04X}" in listening
    assert {address.split(":")[0] for address in listening} == {"0100007F"}
    files = Path(f"/proc/{os.getpid()}/task").glob("*/children")
    children = [pid for file in files for pid in file.read_text().split()]
    assert not [pid for pid in children if b"rerun" in Path(f"/proc/{pid}/cmdline").read_bytes()]


def test_the_page_is_served_and_may_reach_only_its_server(web):
    status, headers, page = get(address_of(web) + "viewer.html")
    assert status == 200
    assert b"re_viewer.js" in page
    assert page.count(f'memory_limit: "{CONFIG.page_memory_mb}MB",'.encode()) == 1
    policy = headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'self'")
    assert "connect-src" not in policy  # as default-src
    assert "://" not in policy
    assert "*" not in policy
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"


def test_the_page_serves_nothing_else(web, capfd):
    for path in ("../../etc/passwd", "signed-in", "/example.org/", "re_viewer.wasm", "page.html"):
        assert get(address_of(web) + path)[0] == 404
    for query in ("newer=x", "newer=1&older=%00", "behind=far", "older=1e9"):
        assert get(f"{address_of(web)}blocks?{query}")[0] == 400
    assert capfd.readouterr().err == ""


def entities(answers, tmp_path):
    """Return the entities in messages for a page, and the stamps of each."""
    file = tmp_path / "page.rrd"
    file.write_bytes(answers[0] + b"".join(content[12:] for content in answers[1:]))
    return {
        name: [stamp for component in parts.values() for stamp in component if stamp is not None]
        for name, parts in read(file).items()
    }


def test_a_page_gets_the_present_before_the_past_and_all_of_both(tmp_path):
    """However late it is opened: static data, the newest, and then older data in turn."""
    session = Session(0.4)
    with Sink("web", CONFIG, "test", tmp_path / "all.rrd", live=True) as sink:
        scene = Scene(CONFIG, sink.stream, sink.lay_out)
        for start in range(0, len(session.messages), 100):
            scene.send(decode(session.messages[start : start + 100]))
            sink.publish()
        said, newest = blocks(sink)
        kept = b"".join([newest[:12], *(m.content for m in split_messages(newest) if m.kept)])
        low, high = 0, said["oldest"]
        first = entities([newest], tmp_path)
        assert max(first["/tension/tendon_0/in"]) == session.of(TENDONS)[-1].stamp_ns
        assert "/scene/tendon_0/tube" in first
        found = {name: set(stamps) for name, stamps in first.items()}
        earliest = min(first["/tension/tendon_0/in"])
        while high > low + 1:
            told, older = blocks(sink, newer=low, older=high)
            if not older:
                break
            high = told["oldest"]
            past = entities([kept, older], tmp_path)
            for name, stamps in past.items():
                found.setdefault(name, set()).update(stamps)
            curve = past.get("/tension/tendon_0/in", [])
            assert not curve or max(curve) < earliest
            earliest = min([earliest, *curve])
        said, rest = blocks(sink, newer=said["newest"])
        assert rest == b""
    sent = entities([(tmp_path / "all.rrd").read_bytes()], tmp_path)
    assert found == {name: set(stamps) for name, stamps in sent.items()}


def test_what_is_kept_for_late_pages_is_bounded_but_never_lacks_static_data(tmp_path):
    kept = BlockBuffer(1_000_000)
    stream = rr.RecordingStream("test")
    encoded = rr.binary_stream(stream)
    sender = Sender(stream)
    sender.send_static("still", rr.Points2D([[1.0, 2.0]]))
    noise = base64.b64encode(np.random.default_rng(0).bytes(75_000)).decode()
    for k in range(40):
        columns = rr.TextDocument.columns(text=[noise])
        sender.send_columns_at("noise", np.array([T0 + 1000 * k]), columns)
        kept.add(encoded.read())
    first, size, seen = kept.read_newer(-1, 0.0), 0, []
    high = first.newest + 1
    while (answer := kept.read_older(high, 0)).content:
        size, high = size + len(answer.content), answer.oldest
        seen += entities([first.content, answer.content], tmp_path)["/noise"]
    assert 800_000 < size < 1_100_000
    assert set(seen) == {T0 + 1000 * k for k in range(40 - len(set(seen)), 40)}
    assert "/still" in entities([first.content], tmp_path)


def test_an_open_page_is_told_that_the_session_has_ended():
    with ThreadPoolExecutor() as pool, Sink("web", CONFIG, "test", None, live=True) as sink:
        blocks(sink, page="a")
        seen = pool.submit(lambda: [blocks(sink, page="a", newer=10**15)[0] for _ in range(2)])
        sink.ended = "The session has ended."
    assert seen.result()[-1]["ended"] == "The session has ended."


@linux
def test_usage_statistics_are_off_whatever_the_users_settings(tmp_path):
    disable_usage_statistics(tmp_path)
    answer = subprocess.run(
        [sys.executable, "-m", "rerun", "analytics", "config"],
        env=os.environ | {"XDG_CONFIG_HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert '"analytics_enabled": false' in answer.stdout


@pytest.fixture
def viewer(tmp_path, monkeypatch):
    """A program of ours in place of Rerun's."""

    def write(words):
        program = tmp_path / "rerun"
        program.write_text(f"#!/bin/sh\n{words}\n")
        program.chmod(0o700)
        monkeypatch.setattr(sinks, "find_program", lambda: program)
        monkeypatch.setattr(sinks, "has_display", lambda: True)

    return write


def test_a_viewer_that_cannot_start_says_why(viewer):
    viewer("echo no such thing >&2\nexit 1")
    with pytest.raises(TeleopError, match="did not start: no such thing"):
        sinks.read_viewer_files()


@linux
@pytest.mark.parametrize("hangs", [True, False])
def test_a_window_gets_all_that_was_sent_and_one_that_hangs_does_not_hold_us(
    session, tmp_path, viewer, hangs
):
    fed = tmp_path / "fed.rrd"
    viewer("exec sleep 60" if hangs else f"exec cat > '{fed}'")

    def complete():
        try:
            stamps = read(fed)["/tension/tendon_0/in"]["Scalars:scalars"]
        except (KeyError, OSError, RuntimeError, ValueError):
            return False
        return max(stamps) == session.of(TENDONS)[-1].stamp_ns

    begin = time.monotonic()
    with Sink("native", CONFIG, "test", None, live=True) as sink:
        Scene(CONFIG, sink.stream).send(decode(session.messages))
        sink.publish()
        assert wait_for_condition(lambda: sink.is_stuck() == hangs, 20)
        assert hangs or wait_for_condition(complete, 20, 0.2)
    assert time.monotonic() - begin < 60  # a hang, not a speed


@linux
def test_a_window_has_a_network_of_its_own(viewer):
    viewer("exec cat")
    with Sink("native", CONFIG, "test", None, live=True) as sink:
        ours, theirs = (os.readlink(f"/proc/{pid}/ns/net") for pid in ("self", sink._window.pid))
        if ours == theirs:  # this system has no namespaces for users
            assert "other users of this machine" in sink.lines[0]
        else:
            assert sink.lines == ["Native view: opened"]


@pytest.mark.parametrize("content", [None, b"no recording"])
def test_a_bad_recording_is_refused_before_anything_is_written(content, tmp_path, refused):
    bad, out = tmp_path / "bad.mcap", tmp_path / "x.rrd"
    if content is not None:
        bad.write_bytes(content)
    assert str(bad) in refused("view", bad, "--view", "rrd", "--out", out)
    assert not out.exists()


@linux
def test_a_killed_view_leaves_a_readable_file(tmp_path):
    path = tmp_path / "cut.rrd"
    script = (
        "import os, signal, sys, time\n"
        "from pathlib import Path\n"
        "from tests.teleop.view.made_session import CONFIG, Session\n"
        "from teleop.view.columns import decode\n"
        "from teleop.view.scene import Scene\n"
        "from teleop.view.sinks import Sink\n"
        "path, size = Path(sys.argv[1]), -1\n"
        "sink = Sink('rrd', CONFIG, 'cut', path, live=True)\n"
        "Scene(CONFIG, sink.stream).send(decode(Session(0.5).messages))\n"
        "while size < (size := path.stat().st_size) or size < 20_000:\n"
        "    time.sleep(0.2)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    subprocess.run([sys.executable, "-c", script, str(path)], check=False)
    assert len(read(path)["/tension/tendon_0/in"]["Scalars:scalars"]) >= 50
