import json
import os
import socket
import struct
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

from teleop.cli import commands
from teleop.errors import TeleopError, UsageError
from teleop.launch.supervisor import wait_for_condition
from teleop.link import ReceivedMessage
from teleop.messages.topics import HAND, TENDONS, TOPICS
from teleop.recording.writer import RecordConfig, RecordingWriter
from teleop.view import sinks
from teleop.view.columns import Sender, decode
from teleop.view.config import ViewConfig, ViewRates
from teleop.view.feed import MessageBuffer, NullDisplay, show_recording, show_session
from teleop.view.local_server import find_free_port
from teleop.view.page import BlockBuffer, split_messages
from teleop.view.scene import Scene
from teleop.view.sinks import Sink, disable_usage_statistics
from tests.teleop.view_session import CONFIG, SENDER, T0, Session, read, save


@pytest.fixture(scope="module")
def session():
    return Session()


@pytest.fixture(scope="module")
def saved(session, tmp_path_factory):
    return save(session.messages, tmp_path_factory.mktemp("view") / "session.rrd")


# feeding


def test_a_recording_is_shown_whole(session, tmp_path, saved):
    with RecordingWriter(RecordConfig(directory=str(tmp_path)), "demo", T0) as writer:
        for topic, data in session.messages:
            message = topic.message.unpack(data)
            stamp = message.stamp_ns
            heard = ReceivedMessage(
                topic, data, stamp + 1000, message.sender, message.sequence, stamp
            )
            writer.write([heard], stamp)
    with Sink("rrd", CONFIG, "demo", tmp_path / "demo.rrd", live=False) as sink:
        fed = show_recording(str(writer.path), Scene(CONFIG, sink.stream), lambda: False, 0.1)
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


def test_what_waits_comes_out_in_time_and_all_of_it():
    paced = MessageBuffer(0.1)
    out = []
    for k in range(1000):
        paced.add([k])
        out.append(paced.take(k * 1_000_000))
    out.append(paced.take(0, all_of_it=True))
    assert [k for block in out for k in block] == list(range(1000))
    assert sum(bool(block) for block in out) == pytest.approx(10, abs=1)


@pytest.mark.parametrize("stretch", [1, 2, 3])
def test_a_block_comes_with_each_call_that_is_due_though_calls_jitter(stretch):
    paced = MessageBuffer(0.125, 0.125)
    paced.stretch = stretch
    calls, blocks = 60, 0
    for k in range(calls):
        paced.add([k])
        jitter_ns = (-1) ** k * 10_000_000
        blocks += bool(paced.take(k * 125_000_000 + jitter_ns))
    assert blocks == pytest.approx(calls / stretch, abs=1)


class OneBatch:
    """A listener that has heard something once."""

    def __init__(self, messages):
        self.heard = [ReceivedMessage(topic, data, 0, SENDER, 0, 0) for topic, data in messages]

    def drain(self):
        heard, self.heard = self.heard, []
        return heard


class Seen:
    """Counts what it is shown."""

    drawn = grown = 0

    def pictures(self, batches):
        self.drawn += sum(map(len, batches.values()))
        return 0

    def curves(self, batches):
        self.grown += sum(map(len, batches.values()))
        return 0

    def stretch(self, factor):
        pass

    def silence(self, silent_ns):
        pass

    def end(self, what, _silent_ns=0):
        self.ended = what


def test_the_link_is_shown_until_the_end_and_what_waited_too(session):
    show = Seen()
    with Sink("none", CONFIG, "test", None, live=True) as sink:
        fed = show_session(OneBatch(session.messages), show, sink, ticks_left(3), 100, (0.0, 10.0))
    assert fed.received == show.drawn == len(session.messages)
    # what grows over time is sent in its own, slower blocks
    assert 0 < show.grown < show.drawn


def ticks_left(count):
    left = [count]

    def stop():
        left[0] -= 1
        return left[0] < 0

    return stop


def test_nothing_is_kept_when_nothing_is_shown():
    with Sink("none", CONFIG, "test", None, live=True) as sink:
        assert sink.stream is None
        assert not sink.stuck()
    assert NullDisplay().pictures({}) == NullDisplay().curves({}) == 0


# config


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"drain_hz": 0.0}, "drain_hz"),
        ({"tension_scale_N": -1.0}, "tension_scale_N"),
        ({"web_port": 80}, "web_port"),
        ({"server_memory_mb": 1}, "server_memory_mb"),
        ({"page_memory_mb": 1}, "page_memory_mb"),
        ({"directory": ""}, "directory"),
    ],
)
def test_a_config_out_of_range_is_refused_by_name(change, field):
    with pytest.raises(ValueError, match=f"^{field}: "):
        ViewConfig(**change)


def test_a_rate_out_of_range_is_refused_by_name():
    with pytest.raises(ValueError, match=r"^tendons: 5000 Hz is outside"):
        ViewRates(tendons=5000.0)


def test_a_topic_shown_more_often_than_its_copies_come_is_received_completely():
    usual, fast = ViewConfig().sampled(), ViewConfig(rate_hz=ViewRates(hand=101.0)).sampled()
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


def sockets_of(pids):
    """Return {local address: port} of the TCP sockets on which the processes listen."""
    inodes = set()
    for pid in pids:
        for entry in Path(f"/proc/{pid}/fd").iterdir():
            try:
                inodes.add(os.readlink(entry).removeprefix("socket:[").removesuffix("]"))
            except FileNotFoundError:
                continue
    found = []
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            _, local, _, state, *rest = line.split()
            if state == "0A" and rest[5] in inodes:
                address, port = local.split(":")
                found.append((address, int(port, 16)))
    return found


@pytest.fixture(scope="module")
def web():
    with Sink("web", CONFIG, "test", None, live=True) as sink:
        yield sink


LOOPBACK_HEX = "0100007F"
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
def test_the_web_view_listens_on_loopback_only_and_leaves_no_program(web):
    listening = sockets_of([os.getpid()])
    assert (LOOPBACK_HEX, urllib.parse.urlsplit(address_of(web)).port) in listening
    assert {address for address, _ in listening} == {LOOPBACK_HEX}
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


def test_the_page_learns_the_newest_stamp_and_says_how_far_it_is_behind():
    with Sink("web", CONFIG, "test", None, live=True) as sink:
        sink.follow(lambda: T0, lambda: None)
        for query, behind_s in (({}, 0), ({"behind": "nan"}, 0), ({"behind": 4.5}, 4.5)):
            said, _ = blocks(sink, newer=10**15, **query)
            assert said["newest_s"] == pytest.approx(T0 * 1e-9)
            assert sink.behind_s == behind_s


@pytest.mark.parametrize(
    "path",
    ["../../etc/passwd", "signed-in", "/example.org/", "re_viewer.wasm", "rrd.py", "page.html"],
)
def test_the_page_serves_nothing_else(web, path):
    assert get(address_of(web) + path)[0] == 404


@pytest.mark.parametrize("query", ["newer=x", "newer=1&older=%00", "behind=far", "older=1e9"])
def test_a_question_that_is_none_is_refused(web, query, capfd):
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


def test_a_page_gets_the_present_before_the_past_and_all_of_both(session, tmp_path):
    """However late it is opened: static data, the newest, and then older data in turn."""
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
    sender.static("still", rr.Points2D([[1.0, 2.0]]))
    noise = np.random.default_rng(0).integers(0, 256, 100_000, np.uint8)
    for k in range(40):
        columns = rr.AnyValues.columns(noise=noise).partition([len(noise)])
        sender.columns_at("noise", np.array([T0 + 1000 * k]), columns)
        kept.add(encoded.read())
    first, size, seen = kept.newer(-1, 0.0), 0, []
    high = first.newest + 1
    while (answer := kept.older(high, 0)).content:
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


def test_a_browser_that_disconnects_is_no_error(web, capfd):
    address = urllib.parse.urlsplit(address_of(web))
    for _ in range(3):
        with socket.create_connection((address.hostname, address.port)) as browser:
            reset_at_close = struct.pack("ii", 1, 0)
            browser.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, reset_at_close)
            file = f"{address.path}re_viewer_bg.wasm"
            browser.sendall(f"GET {file} HTTP/1.1\r\nHost: localhost:1\r\n\r\n".encode())
            browser.recv(1000)
    assert get(address_of(web))[0] == 200
    time.sleep(0.2)
    assert capfd.readouterr().err == ""


def test_a_second_web_view_takes_another_port_and_secret(web):
    with Sink("web", CONFIG, "test", None, live=True) as second:
        one, other = (urllib.parse.urlsplit(address_of(sink)) for sink in (web, second))
        assert one.port != other.port
        assert one.path != other.path
        assert len(one.path) >= 22  # 128 bits


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


@linux
def test_a_window_that_gets_no_more_data_for_a_damaged_block_is_stuck(tmp_path, monkeypatch):
    program = tmp_path / "rerun"
    program.write_text("#!/bin/sh\nexec cat > /dev/null\n")
    program.chmod(0o700)
    monkeypatch.setattr(sinks, "find_program", lambda: program)
    monkeypatch.setenv("DISPLAY", ":0")
    with sinks.Window(100) as window:
        assert not window.stuck()
        window.add(b"no block of Rerun")
        assert wait_for_condition(window.stuck, 20)


@linux
@pytest.mark.parametrize("hangs", [True, False])
def test_a_window_gets_all_that_was_sent_and_one_that_hangs_does_not_hold_us(
    session, tmp_path, monkeypatch, hangs
):
    """In place of Rerun's program is one that keeps what it is fed, or reads nothing."""
    fed, program = tmp_path / "fed.rrd", tmp_path / "rerun"
    program.write_text("#!/bin/sh\n" + ("exec sleep 60" if hangs else f"exec cat > '{fed}'") + "\n")
    program.chmod(0o700)
    monkeypatch.setattr(sinks, "find_program", lambda: program)
    monkeypatch.setenv("DISPLAY", ":0")
    begin = time.monotonic()
    with Sink("native", CONFIG, "test", None, live=True) as sink:
        scene = Scene(CONFIG, sink.stream)
        scene.send(decode(session.messages))
        sink.publish()
        assert wait_for_condition(lambda: sink.stuck() == hangs, 20)
        if not hangs:
            assert wait_for_condition(lambda: fed.exists() and whole(fed, session), 20, 0.2)
    assert time.monotonic() - begin < 60  # a hang, not a speed


def whole(file, session):
    try:
        stamps = read(file)["/tension/tendon_0/in"]["Scalars:scalars"]
    except (KeyError, RuntimeError, ValueError):
        return False
    return max(stamps) == session.of(TENDONS)[-1].stamp_ns


@linux
def test_a_window_has_a_network_of_its_own(tmp_path, monkeypatch):
    program = tmp_path / "rerun"
    program.write_text('#!/bin/sh\ncat /proc/net/dev > "$XDG_CONFIG_HOME/dev"\nexec cat\n')
    program.chmod(0o700)
    monkeypatch.setattr(sinks, "find_program", lambda: program)
    monkeypatch.setenv("DISPLAY", ":0")
    with Sink("native", CONFIG, "test", None, live=True) as sink:
        ours, theirs = (os.readlink(f"/proc/{pid}/ns/net") for pid in ("self", sink._window.pid))
        if ours == theirs:  # this system has no namespaces for users
            assert "other users of this machine" in sink.lines[0]
        else:
            assert sink.lines == ["Native view: opened"]


@pytest.mark.parametrize("content", [None, b"", b"no recording"])
def test_a_bad_recording_is_refused_before_anything_is_written(content, tmp_path, capsys):
    bad, out = tmp_path / "bad.mcap", tmp_path / "x.rrd"
    if content is not None:
        bad.write_bytes(content)
    assert commands.main(["view", str(bad), "--view", "rrd", "--out", str(out)]) == 2
    captured = capsys.readouterr()
    assert str(bad) in captured.err
    assert len(captured.err.splitlines()) == 1
    assert captured.out == ""
    assert not out.exists()


def test_a_viewer_that_cannot_start_says_why(monkeypatch, tmp_path):
    program = tmp_path / "rerun"
    program.write_text("#!/bin/sh\necho no such thing >&2\nexit 1\n")
    program.chmod(0o700)
    monkeypatch.setattr(sinks, "find_program", lambda: program)
    with pytest.raises(TeleopError, match="did not start: no such thing"):
        sinks.read_viewer_files()


def test_a_free_port_is_taken_when_the_first_choice_is_not():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert find_free_port(port) != port


@linux
def test_the_viewer_ends_when_we_are_killed(tmp_path):
    script = (
        "import sys, time\n"
        "from teleop.view.sinks import ViewerProcess\n"
        "viewer = ViewerProcess(['--serve-grpc', '--port', 'auto'])\n"
        "print(viewer.process.pid, flush=True)\n"
        "time.sleep(60)\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    child = Path(f"/proc/{int(parent.stdout.readline())}/stat")
    assert child.exists()
    parent.kill()
    parent.wait()
    parent.stdout.close()
    end = time.monotonic() + 10
    while child.exists() and " Z " not in child.read_text() and time.monotonic() < end:
        time.sleep(0.05)
    assert not child.exists() or " Z " in child.read_text()


@linux
def test_a_killed_view_leaves_a_readable_file(tmp_path):
    path = tmp_path / "cut.rrd"
    script = (
        "import os, signal, sys\n"
        "from pathlib import Path\n"
        "from tests.teleop.view_session import CONFIG, Session\n"
        "from teleop.view.columns import decode\n"
        "from teleop.view.scene import Scene\n"
        "from teleop.view.sinks import Sink\n"
        "import time\n"
        f"sink = Sink('rrd', CONFIG, 'cut', Path({str(path)!r}), live=True)\n"
        "Scene(CONFIG, sink.stream).send(decode(Session(0.5).messages))\n"
        "time.sleep(1)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    subprocess.run([sys.executable, "-c", script], check=False)
    cut = read(path)
    assert len(cut["/tension/tendon_0/in"]["Scalars:scalars"]) >= 50


def test_the_clock_of_the_view_is_that_of_the_messages(saved):
    assert all(abs(stamp - T0) < 2e9 for stamp in saved["/hand/joint_0/force"]["Scalars:scalars"])
