import json
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from pathlib import Path

import pytest
import rerun as rr
from rerun.chunk import RrdReader

from teleop.app import cli
from teleop.errors import TeleopError, UsageError
from teleop.link import ReceivedMessage
from teleop.process import Stop
from teleop.recording.config import RecordConfig
from teleop.recording.writer import RecordingWriter
from teleop.topics import HAND, TENDONS, TOPICS
from teleop.view.batch import decode
from teleop.view.config import ViewConfig, ViewRates
from teleop.view.feed import Discard, PacedMessages, from_link, from_recording
from teleop.view.ports import free_port
from teleop.view.scene import Scene
from teleop.view.sinks import Sink
from teleop.view.viewer_process import ViewerProcess
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
        fed = from_recording(str(writer.path), Scene(CONFIG, sink.stream), lambda: False, 0.1)
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
    paced = PacedMessages(0.1)
    out = []
    for k in range(1000):
        paced.add([k])
        out.append(paced.take(k * 1_000_000))
    out.append(paced.take(0, all_of_it=True))
    assert [k for block in out for k in block] == list(range(1000))
    assert sum(bool(block) for block in out) == pytest.approx(10, abs=1)


@pytest.mark.parametrize("stretch", [1, 2, 3])
def test_a_block_comes_with_each_call_that_is_due_though_calls_jitter(stretch):
    paced = PacedMessages(0.125, 0.125)
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


def test_the_link_is_shown_until_the_end_and_what_waited_too(session):
    show = Seen()
    with Sink("none", CONFIG, "test", None, live=True) as sink:
        fed = from_link(OneBatch(session.messages), show, sink, ticks_left(3), 100, (0.0, 10.0))
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
    assert Discard().pictures({}) == Discard().curves({}) == 0


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


@linux
def test_the_web_view_listens_on_loopback_only(web):
    listening = sockets_of([os.getpid(), web._viewer.pid])
    assert len(listening) >= 3  # data, the program's page, ours
    assert {address for address, _ in listening} == {LOOPBACK_HEX}


def test_the_page_is_served_and_may_reach_only_this_machine(web):
    address = web.lines[0].removeprefix("Web view: ")
    with urllib.request.urlopen(address + "viewer.html", timeout=10) as answer:  # noqa: S310
        page = answer.read().decode()
        policy = answer.headers["Content-Security-Policy"]
    assert "re_viewer.js" in page
    assert page.count(f'memory_limit: "{CONFIG.page_memory_mb}MB",') == 1
    with urllib.request.urlopen(address + "instance", timeout=10) as answer:  # noqa: S310
        query = urllib.parse.parse_qs(json.load(answer)["query"])
    assert query["theme"] == ["dark"]
    (data,) = query["url"]
    assert data == web._viewer.url
    reachable = policy.split("connect-src ")[1].split(";")[0].split()
    assert reachable == ["'self'", "http://" + urllib.parse.urlsplit(data[6:]).netloc]
    assert policy.startswith("default-src 'self'")
    sources = [word for rule in policy.split(";") for word in rule.split()[1:]]
    assert not [s for s in sources if "://" in s and "127.0.0.1" not in s]
    assert "*" not in policy


def test_the_page_learns_the_newest_stamp_and_says_how_far_it_is_behind():
    with Sink("web", CONFIG, "test", None, live=True) as sink:
        address = sink.lines[0].removeprefix("Web view: ") + "instance"
        sink.follow(lambda: T0)
        for query, behind_s in (
            ("", 0),
            ("?behind=nan", 0),
            ("?behind=x", 0),
            ("?behind=4.5", 4.5),
        ):
            with urllib.request.urlopen(address + query, timeout=10) as answer:  # noqa: S310
                assert json.load(answer)["newest_s"] == pytest.approx(T0 * 1e-9)
            assert sink.behind_s == behind_s


@pytest.mark.parametrize(
    "path", ["/../etc/passwd", "/signed-in", "//example.org/", "/re_viewer.wasm"]
)
def test_the_page_serves_nothing_else(web, path):
    port = urllib.parse.urlsplit(web.lines[0].removeprefix("Web view: ")).port
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=10)
    assert refused.value.code == 404
    refused.value.close()


def test_a_browser_that_disconnects_is_no_error(web, capfd):
    address = urllib.parse.urlsplit(web.lines[0].removeprefix("Web view: "))
    for _ in range(3):
        with socket.create_connection((address.hostname, address.port)) as browser:
            reset_at_close = struct.pack("ii", 1, 0)
            browser.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, reset_at_close)
            browser.sendall(b"GET /re_viewer_bg.wasm HTTP/1.0\r\n\r\n")
            browser.recv(1000)
    with urllib.request.urlopen(web.lines[0].removeprefix("Web view: "), timeout=10) as answer:  # noqa: S310
        answer.read()
    time.sleep(0.2)
    assert capfd.readouterr().err == ""


def test_a_second_web_view_takes_other_ports(web):
    with Sink("web", CONFIG, "test", None, live=True) as second:
        assert second.lines != web.lines
        assert second._viewer.url != web._viewer.url


@linux
def test_usage_statistics_are_off_whatever_the_users_settings(web):
    environment = dict(
        entry.split("=", 1)
        for entry in Path(f"/proc/{web._viewer.pid}/environ").read_text().split("\0")
        if "=" in entry
    )
    answer = subprocess.run(
        [sys.executable, "-m", "rerun", "analytics", "config"],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert '"analytics_enabled": false' in answer.stdout


def test_a_page_nobody_feeds_answers_in_words(monkeypatch):
    monkeypatch.setattr(signal, "signal", lambda *_: None)  # pytest keeps its own
    with Sink("web", CONFIG, "test", None, live=True) as sink:
        sink._viewer.close()
        assert not sink.alive()
        with pytest.raises(urllib.error.HTTPError) as refused:
            urllib.request.urlopen(  # noqa: S310
                sink.lines[0].removeprefix("Web view: ") + "viewer.html", timeout=10
            )
        assert refused.value.code == 502
        refused.value.close()
        fed = from_link(OneBatch([]), Discard(), sink, (stop := Stop()), 100, (0.0, 0.0))
        assert stop.reason == "the viewer has ended"
        assert "program ended" in fed.fault


@linux
def test_a_viewer_that_hangs_is_noticed_and_does_not_hold_us(session, capfd):
    with Sink("web", CONFIG, "test", None, live=True) as sink:
        pid = sink._viewer.pid
        scene = Scene(CONFIG, sink.stream)
        os.kill(pid, signal.SIGSTOP)
        for _ in range(20):
            scene.send(decode(session.messages[:1000]))
        assert [sink.stuck(), sink.stuck()] == [False, True]
        begin = time.monotonic()
    assert time.monotonic() - begin < 20  # a hang, not a speed
    assert not Path(f"/proc/{pid}").exists() or "Z" in Path(f"/proc/{pid}/stat").read_text()
    capfd.readouterr()


@linux
def test_a_viewer_that_hangs_with_all_its_data_in_the_pipe_does_not_hold_us(session, capfd):
    sink = Sink("web", CONFIG, "test", None, live=True)
    scene = Scene(CONFIG, sink.stream)
    scene.send(decode(session.messages[:100]))
    sink.stream.flush()
    os.kill(sink._viewer.pid, signal.SIGSTOP)
    scene.send(decode(session.messages[100:200]))
    rescue = threading.Timer(20.0, sink._viewer.kill)  # so that a hang fails and does not hang us
    rescue.start()
    begin = time.monotonic()
    sink.close()
    rescue.cancel()
    assert time.monotonic() - begin < 15
    capfd.readouterr()


@pytest.mark.parametrize("content", [None, b"", b"no recording"])
def test_a_bad_recording_is_refused_before_anything_is_written(content, tmp_path, capsys):
    bad, out = tmp_path / "bad.mcap", tmp_path / "x.rrd"
    if content is not None:
        bad.write_bytes(content)
    assert cli.main(["view", str(bad), "--view", "rrd", "--out", str(out)]) == 2
    captured = capsys.readouterr()
    assert str(bad) in captured.err
    assert len(captured.err.splitlines()) == 1
    assert captured.out == ""
    assert not out.exists()


def test_a_viewer_that_cannot_start_says_why():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(TeleopError, match=r"did not start: \S"):
            ViewerProcess(["--no-such-option"], taken.getsockname()[1])


def test_a_free_port_is_taken_when_the_first_choice_is_not():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert free_port(port) != port


@linux
def test_the_viewer_ends_when_we_are_killed(tmp_path):
    script = (
        "import sys, time\n"
        "from teleop.view.ports import free_port\n"
        "from teleop.view.viewer_process import ViewerProcess\n"
        "viewer = ViewerProcess(['--serve-grpc'], free_port(0))\n"
        "print(viewer.pid, flush=True)\n"
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
        "from teleop.view.batch import decode\n"
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
