import math
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
import warnings
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from hypothesis import given
from hypothesis import strategies as st
from rerun.chunk import RrdReader

from teleop import cli
from teleop.errors import TeleopError, UsageError
from teleop.link import Heard
from teleop.messages import (
    MAX_JOINTS,
    MAX_SECTIONS,
    MAX_TENDONS,
    PROFILE_POINTS,
    Command,
    Event,
    Hand,
    LoopReport,
    MessageError,
    Sheath,
    SlaveState,
    TendonState,
    TensionProfile,
    padded,
    text_bytes,
)
from teleop.process import Stop
from teleop.recording.config import RecordConfig
from teleop.recording.writer import RecordingWriter
from teleop.session import State
from teleop.topics import COMMAND, EVENT, HAND, PROFILE, REPORT, SHEATH, STATE, TENDONS, Role
from teleop.view.batch import decode, thinned
from teleop.view.colours import UNKNOWN, rgba
from teleop.view.config import ViewConfig, ViewRates
from teleop.view.feed import Paced, discard, from_link, from_recording
from teleop.view.profile_plot import Plane, ticks
from teleop.view.scene import Scene
from teleop.view.shape import centreline
from teleop.view.sinks import Sink
from teleop.view.viewer_process import ViewerProcess, free_port

T0 = 1_790_000_000_000_000_000
SENDER = 77
CONFIG = ViewConfig(tension_scale_N=10.0)


def tendon_state(k, bench=True):
    value = 5 + 4 * math.sin(k / 50)
    return TendonState(
        tendons=2,
        proximal_tension=padded((value, value + 1), MAX_TENDONS),
        proximal_displacement=padded((k * 1e-6, math.nan), MAX_TENDONS),
        distal_tension=padded((value / 2, value / 3), MAX_TENDONS),
        distal_tension_low=padded((value / 3, value / 4), MAX_TENDONS),
        distal_tension_high=padded((value, value / 2), MAX_TENDONS),
        bench_distal_tension=padded(
            (value / 2 + 0.1 if bench else math.nan, math.nan), MAX_TENDONS
        ),
        bench_distal_displacement=(math.nan,) * MAX_TENDONS,
    )


def tension_profile(k, tendon=0):
    x = np.linspace(0, 1, PROFILE_POINTS)
    tension = (6 + tendon + math.sin(k)) * np.exp(-x / 3)
    return TensionProfile(tendon=tendon, length=0.8, front=0.2, tension=tuple(tension.tolist()))


def sheath(tendon=0):
    return Sheath(
        tendon=tendon,
        sections=2,
        section_length=padded((0.3, 0.5), MAX_SECTIONS),
        section_radius=padded((math.inf, 0.2), MAX_SECTIONS),
    )


class Session:
    """A session's messages, packed in order of time."""

    def __init__(self, seconds=1.0):
        self.messages = []
        self.sequences = {}
        for k in range(round(seconds * 1000)):
            stamp = T0 + k * 1_000_000
            self.add(TENDONS, tendon_state(k), stamp)
            force = padded((k * 0.01,), MAX_JOINTS)
            self.add(STATE, SlaveState(joints=1, force=force), stamp)
            self.add(HAND, Hand(joints=1, force=padded((-k * 0.003,), MAX_JOINTS)), stamp)
            self.add(COMMAND, Command(position=padded((k * 1e-5,), MAX_JOINTS)), stamp)
            if k % 20 == 0:
                for tendon in (0, 1):
                    self.add(PROFILE, tension_profile(k, tendon), stamp)
            if k % 1000 == 0:
                for tendon in (0, 1):
                    self.add(SHEATH, sheath(tendon), stamp)
            if k % 500 == 0:
                report = LoopReport(role=Role.SLAVE, rate_hz=999.5, lateness_max_ns=250_000, lost=k)
                self.add(REPORT, report, stamp)
        fault = Event(role=Role.SLAVE, state=State.FAULT, text=text_bytes("load cell silent"))
        self.add(EVENT, fault, T0 + 300_000_000)

    def add(self, topic, message, stamp):
        sequence = self.sequences[topic] = self.sequences.get(topic, -1) + 1
        self.messages.append((topic, message.pack(SENDER, sequence, stamp)))

    def of(self, topic):
        return [topic.message.unpack(data) for t, data in self.messages if t is topic]


@pytest.fixture(scope="module")
def session():
    return Session()


def read(path):
    """Return {entity: {component: {stamp: [values]}}}; static ones under the stamp None."""
    entities = {}
    for chunk in RrdReader(path).stream():
        table = chunk.to_record_batch().to_pydict()
        stamps = table.get("time") or [None] * chunk.num_rows
        for name, column in table.items():
            if name in ("time", "rerun.controls.RowId"):
                continue
            rows = entities.setdefault(chunk.entity_path, {}).setdefault(name, {})
            for stamp, value in zip(stamps, column, strict=True):
                rows[stamp if stamp is None else np.datetime64(stamp, "ns").astype(int)] = value
    return entities


@pytest.fixture(scope="module")
def saved(session, tmp_path_factory):
    """The session fed in blocks of 40 ms through the pipeline to a file, and read back."""
    path = tmp_path_factory.mktemp("view") / "session.rrd"
    with Sink("rrd", CONFIG, "test", path, live=False) as sink:
        scene = Scene(CONFIG, sink.stream)
        for start in range(0, len(session.messages), 163):
            scene.send(decode(session.messages[start : start + 163]))
    return read(path)


# decoding and thinning


def test_a_batch_decodes_as_message_by_message(session):
    batches = decode(session.messages)
    for topic, rows in batches.items():
        expected = session.of(topic)
        assert len(rows) == len(expected)
        for name in topic.message.schema.dtype.names:
            values = np.array([getattr(message, name) for message in expected])
            np.testing.assert_array_equal(rows[name], values, err_msg=f"{topic.name}.{name}")


def test_messages_of_another_layout_are_refused(session):
    topic, data = session.messages[0]
    damaged = data[:8] + b"\xff\xff\xff\xff" + data[12:]
    for foreign in (damaged, data[:-8], data + bytes(8)):
        with pytest.raises(MessageError):
            decode([(topic, data), (topic, foreign)])


def rows_at(stamps):
    rows = np.zeros(len(stamps), TENDONS.message.schema.dtype)
    rows["stamp_ns"] = stamps
    return rows


@given(
    steps=st.lists(st.integers(1, 30_000_000), min_size=1, max_size=200),
    rate=st.floats(1, 1000),
    cuts=st.integers(1, 5),
)
def test_thinning_keeps_the_newest_and_the_rate(steps, rate, cuts):
    stamps = T0 + np.cumsum(steps)
    for block in np.array_split(stamps, cuts):
        kept = thinned(rows_at(block), rate)["stamp_ns"]
        assert len(kept) <= len(block)
        if len(block):
            assert kept[-1] == block[-1]
            assert len(kept) <= (block[-1] - block[0]) * rate * 1e-9 + 2
            # whatever is hidden is followed within a period by something shown
            assert all(np.diff(kept) <= np.diff(block).max(initial=0) + 1e9 / rate + 1)


def test_a_thousand_a_second_become_a_hundred(session):
    rows = decode(session.messages)[TENDONS]
    assert len(thinned(rows, 100)) == pytest.approx(100, abs=2)
    assert len(thinned(rows, 1000)) == len(rows)


# colours


def lightness(colour):
    """CIE L* of 0xRRGGBBAA, D65."""
    rgb = np.array([(colour >> shift) & 0xFF for shift in (24, 16, 8)]) / 255
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    y = linear @ [0.2126, 0.7152, 0.0722]
    return 116 * np.cbrt(y) - 16 if y > 0.008856 else 903.3 * y


def test_lightness_rises_evenly_with_tension():
    levels = np.array([lightness(int(c)) for c in rgba(np.linspace(0, 20, 81), 20.0)])
    steps = np.diff(levels)
    assert (steps > 0).all()
    assert levels[0] < 20
    assert levels[-1] > 88
    assert steps.max() < 3 * steps.mean()


def test_tensions_off_the_scale_take_its_ends_and_unknown_ones_grey():
    colours = rgba(np.array([-1.0, 0.0, 20.0, 1e9, math.nan, math.inf]), 20.0)
    assert colours[0] == colours[1]
    assert colours[2] == colours[3]
    assert colours[4] == colours[5] == UNKNOWN
    assert (colours & 0xFF == 0xFF).all()


# shape


@given(
    sections=st.lists(
        st.tuples(
            st.floats(0.01, 1.0),
            st.one_of(st.just(math.inf), st.floats(0.03, 2), st.floats(-2, -0.03)),
        ),
        min_size=1,
        max_size=6,
    ),
    gap=st.floats(0, 0.05),
)
def test_the_drawn_sheath_has_the_length_and_the_bends_of_the_real_one(sections, gap):
    length, radius = np.array(sections).T
    s = np.linspace(0, length.sum(), 20_001)
    line = centreline(length, radius, s, gap)
    chords = np.diff(line, axis=0)
    pieces = np.linalg.norm(chords, axis=1)
    # a chord is shorter than its arc by (angle per piece)^2 / 24, under 1e-6 here
    assert pieces.sum() == pytest.approx(length.sum(), rel=1e-5)
    assert pieces.max() < 1.001 * s[1]  # and there are no jumps
    heading = np.unwrap(np.arctan2(chords[:, 1], chords[:, 0]))
    # nor kinks where sections meet
    assert np.abs(np.diff(heading)).max() <= 1.01 * s[1] / np.abs(radius).min() + 1e-6
    ends = np.cumsum(length)
    middle = (s[1:] + s[:-1]) / 2
    for begin, end, l_k, r_k in zip(ends - length, ends, length, radius, strict=True):
        inside = heading[(middle > begin + 2 * s[1]) & (middle < end - 2 * s[1])]
        assert inside[-1] - inside[0] == pytest.approx(l_k / r_k, abs=6 * s[1] / abs(r_k) + 1e-6)


def test_a_coil_does_not_run_into_itself():
    line = centreline(np.array([2.0]), np.array([0.1]), np.linspace(0, 2, 2001), turn_gap=0.04)
    turn = round(2 * math.pi * 0.1 * 1000)
    assert np.linalg.norm(line[turn:] - line[:-turn], axis=1).min() > 0.039


# the plot


@given(st.floats(1e-3, 1e4))
def test_ticks_are_few_and_round(top):
    values = ticks(top)
    assert 3 <= len(values) <= 9
    assert values[0] == 0
    assert values[-1] <= top * (1 + 1e-9) < values[-1] + values[1] * (1 + 1e-9)


def test_the_plane_is_linear_in_metres_and_newtons():
    plane = Plane(length=0.8, scale=20.0)
    corner = plane.points(np.array([0.0, 0.8, 0.4]), np.array([0.0, 20.0, 10.0]))
    np.testing.assert_allclose(corner[1] - corner[0], 2 * (corner[2] - corner[0]))
    assert corner[1][1] == pytest.approx(-1)


# what a file holds


def test_the_profile_arrives_as_it_was_sent(session, saved):
    for tendon in (0, 1):
        sent = {m.stamp_ns: m.tension for m in session.of(PROFILE) if m.tendon == tendon}
        shown = saved[f"/profile/tendon_{tendon}/tension"]["tension"]
        assert len(shown) >= 30
        for stamp, tension in shown.items():
            np.testing.assert_allclose(tension, sent[stamp], atol=1e-6)


def test_the_plotted_curve_is_the_profile(session, saved):
    sent = {m.stamp_ns: m for m in session.of(PROFILE) if m.tendon == 1}
    for stamp, (strip,) in saved["/profile/tendon_1/curve"]["LineStrips2D:strips"].items():
        across, down = np.array(strip).T
        np.testing.assert_allclose(-down * CONFIG.tension_scale_N, sent[stamp].tension, rtol=1e-6)
        np.testing.assert_allclose(np.diff(across), across[-1] / 64, rtol=1e-4)


def test_the_tube_has_the_colour_of_its_tension(session, saved):
    sent = {m.stamp_ns: np.array(m.tension) for m in session.of(PROFILE) if m.tendon == 0}
    shown = saved["/sheath/tendon_0/tube"]["LineStrips3D:colors"]
    assert len(shown) >= 30
    for stamp, colours in shown.items():
        middle = [(a + b) / 2 for a, b in zip(sent[stamp], sent[stamp][1:], strict=False)]
        expected = [int(rgba(np.array([t]), CONFIG.tension_scale_N)[0]) for t in middle]
        assert colours == expected


def test_the_tube_is_the_sheath(saved):
    for tendon in (0, 1):
        strips = np.array(saved[f"/sheath/tendon_{tendon}/tube"]["LineStrips3D:strips"][None])
        assert len(strips) == PROFILE_POINTS - 1
        pieces = np.linalg.norm(np.diff(strips, axis=1), axis=2)
        np.testing.assert_allclose(pieces.sum(axis=1), 0.8 / 64, rtol=1e-3)
        np.testing.assert_allclose(strips[1:, 0], strips[:-1, -1], atol=1e-6)


def test_the_front_is_marked_where_it_is(saved):
    # X' = 0.2 m lies in the first, straight section
    for position in saved["/sheath/tendon_0/front"]["Points3D:positions"].values():
        if position is not None:
            np.testing.assert_allclose(position[0], [0.2, 0, 0], atol=0.8 / 256)


@pytest.mark.parametrize(
    ("entity", "topic", "value"),
    [
        ("/tension/tendon_0/in", TENDONS, lambda m: m.proximal_tension[0]),
        ("/tension/tendon_1/in", TENDONS, lambda m: m.proximal_tension[1]),
        ("/tension/tendon_1/out", TENDONS, lambda m: m.distal_tension[1]),
        ("/tension/tendon_0/out_low", TENDONS, lambda m: m.distal_tension_low[0]),
        ("/tension/tendon_0/out_high", TENDONS, lambda m: m.distal_tension_high[0]),
        ("/tension/tendon_0/out_measured", TENDONS, lambda m: m.bench_distal_tension[0]),
        ("/force/joint_0/tip", STATE, lambda m: m.force[0]),
        ("/force/joint_0/hand", HAND, lambda m: m.force[0]),
        ("/position/joint_0/asked", COMMAND, lambda m: m.position[0]),
        ("/loop/slave/rate_hz", REPORT, lambda m: m.rate_hz),
        ("/loop/slave/lateness_ms", REPORT, lambda m: m.lateness_max_ns / 1e6),
    ],
)
def test_curves_hold_the_values_that_were_sent(session, saved, entity, topic, value):
    sent = {m.stamp_ns: value(m) for m in session.of(topic)}
    shown = saved[entity]["Scalars:scalars"]
    assert max(shown) == max(sent), "the newest is missing"
    rate = getattr(CONFIG.rate_hz, topic.name, 2)
    assert rate - 2 <= len(shown) <= rate + 27  # of one second, in 26 blocks
    for stamp, (number,) in shown.items():
        assert number == pytest.approx(sent[stamp], rel=1e-12)


def test_a_sensor_that_is_not_there_draws_nothing(saved):
    assert "/tension/tendon_1/out_measured" not in saved
    assert "/displacement/tendon_0/out_measured" not in saved
    assert "/displacement/tendon_1/in" not in saved
    assert "/displacement/tendon_0/in" in saved


def test_only_tendons_and_joints_in_use_are_drawn(saved):
    assert not [name for name in saved if "tendon_2" in name or "joint_1" in name]


def test_events_are_in_the_log(saved):
    assert list(saved["/events"]["TextLog:text"].values()) == [["slave: load cell silent"]]
    assert list(saved["/events"]["TextLog:level"].values()) == [["ERROR"]]


def test_a_sheath_is_drawn_again_only_if_it_changed(session, tmp_path):
    with Sink("rrd", CONFIG, "test", tmp_path / "s.rrd", live=False) as sink:
        scene = Scene(CONFIG, sink.stream)
        for _ in range(5):
            scene.send(decode(session.messages[:9]))
    strips = [
        chunk
        for chunk in RrdReader(tmp_path / "s.rrd").stream()
        if chunk.entity_path == "/sheath/tendon_0/tube" and chunk.is_static
    ]
    assert len(strips) <= 1


def test_a_role_of_the_future_is_shown_by_its_number(tmp_path):
    session = Session(0)
    session.add(EVENT, Event(role=99, state=99, text=text_bytes("hello")), T0)
    with Sink("rrd", CONFIG, "test", tmp_path / "s.rrd", live=False) as sink:
        Scene(CONFIG, sink.stream).send(decode(session.messages))
    assert ["role_99: hello"] in read(tmp_path / "s.rrd")["/events"]["TextLog:text"].values()


# feeding


def test_a_recording_is_shown_whole(session, tmp_path, saved):
    with RecordingWriter(RecordConfig(directory=str(tmp_path)), "demo", T0) as writer:
        for topic, data in session.messages:
            message = topic.message.unpack(data)
            stamp = message.stamp_ns
            heard = Heard(topic, data, stamp + 1000, message.sender, message.sequence, stamp)
            writer.write([heard], stamp)
    with Sink("rrd", CONFIG, "demo", tmp_path / "demo.rrd", live=False) as sink:
        fed = from_recording(str(writer.path), Scene(CONFIG, sink.stream).send, lambda: False, 0.1)
    assert fed.received == len(session.messages)
    again = read(tmp_path / "demo.rrd")
    assert {name for name in again if "__" not in name} == {n for n in saved if "__" not in n}
    last = max(again["/tension/tendon_0/in"]["Scalars:scalars"])
    assert last == session.of(TENDONS)[-1].stamp_ns


def test_what_waits_comes_out_in_time_and_all_of_it():
    paced = Paced(0.1)
    out = []
    for k in range(1000):
        paced.add([k])
        out.append(paced.take(k * 1_000_000))
    out.append(paced.take(0, all_of_it=True))
    assert [k for block in out for k in block] == list(range(1000))
    assert sum(bool(block) for block in out) == pytest.approx(10, abs=1)


class OneBatch:
    """A listener that has heard something once."""

    def __init__(self, messages):
        self.heard = [Heard(topic, data, 0, SENDER, 0, 0) for topic, data in messages]

    def drain(self):
        heard, self.heard = self.heard, []
        return heard


def test_the_link_is_shown_until_the_end_and_what_waited_too(session):
    seen = []

    def show(batches):
        seen.append(batches)
        return sum(map(len, batches.values()))

    with Sink("none", CONFIG, "test", None, live=True) as sink:
        fed = from_link(OneBatch(session.messages), show, sink, ticks_left(3), 100, (0.0, 10.0))
    assert fed.received == fed.shown == len(session.messages)
    assert {topic.name for batch in seen for topic in batch} == {
        t.name for t, _ in session.messages
    }


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
    assert discard({}) == 0


# config


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"drain_hz": 0.0}, "drain_hz"),
        ({"tension_scale_N": -1.0}, "tension_scale_N"),
        ({"web_port": 80}, "web_port"),
        ({"server_memory_mb": 1}, "server_memory_mb"),
        ({"directory": ""}, "directory"),
    ],
)
def test_a_config_out_of_range_is_refused_by_name(change, field):
    with pytest.raises(ValueError, match=f"^{field}: "):
        ViewConfig(**change)


def test_a_rate_out_of_range_is_refused_by_name():
    with pytest.raises(ValueError, match=r"^tendons: 5000 Hz is outside"):
        ViewRates(tendons=5000.0)


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
    with urllib.request.urlopen(address, timeout=10) as answer:  # noqa: S310
        page = answer.read().decode()
        policy = answer.headers["Content-Security-Policy"]
    assert "re_viewer.js" in page
    data = urllib.parse.parse_qs(urllib.parse.urlsplit(address).query)["url"][0]
    assert data == web._viewer.url
    reachable = policy.split("connect-src ")[1].split(";")[0].split()
    assert reachable == ["'self'", "http://" + urllib.parse.urlsplit(data[6:]).netloc]
    assert policy.startswith("default-src 'self'")
    sources = [word for rule in policy.split(";") for word in rule.split()[1:]]
    assert not [s for s in sources if "://" in s and "127.0.0.1" not in s]
    assert "*" not in policy


@pytest.mark.parametrize(
    "path", ["/../etc/passwd", "/signed-in", "//example.org/", "/re_viewer.wasm"]
)
def test_the_page_serves_nothing_else(web, path):
    port = urllib.parse.urlsplit(web.lines[0].removeprefix("Web view: ")).port
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(f"http://127.0.0.1:{port}{path}", timeout=10)
    assert refused.value.code == 404
    refused.value.close()


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
            urllib.request.urlopen(sink.lines[0].removeprefix("Web view: "), timeout=10)  # noqa: S310
        assert refused.value.code == 502
        refused.value.close()
        fed = from_link(OneBatch([]), discard, sink, (stop := Stop()), 100, (0.0, 0.0))
        assert stop.reason == "the viewer has ended"
        assert "ended by itself" in fed.fault


@linux
def test_a_viewer_that_hangs_is_noticed_and_does_not_hold_us(session, capfd):
    with Sink("web", CONFIG, "test", None, live=True) as sink:
        pid = sink._viewer.pid
        scene = Scene(CONFIG, sink.stream)
        os.kill(pid, signal.SIGSTOP)
        for _ in range(20):
            scene.send(decode(session.messages[:1000]))
        assert sink.stuck()
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
    bad, out = tmp_path / "bad.mcap", tmp_path / "new" / "deep" / "x.rrd"
    if content is not None:
        bad.write_bytes(content)
    assert cli.main(["view", str(bad), "--view", "rrd", "--out", str(out)]) == 2
    captured = capsys.readouterr()
    assert str(bad) in captured.err
    assert len(captured.err.splitlines()) == 1
    assert captured.out == ""
    assert not out.parent.parent.exists()


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
        "from teleop.view.viewer_process import ViewerProcess, free_port\n"
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
        "from tests.teleop.test_view import CONFIG, Session\n"
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
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rr.error_utils.RerunWarning)  # it has no footer
        cut = read(path)
    assert len(cut["/tension/tendon_0/in"]["Scalars:scalars"]) >= 50


def test_the_clock_of_the_view_is_that_of_the_messages(saved):
    assert all(abs(stamp - T0) < 2e9 for stamp in saved["/force/joint_0/hand"]["Scalars:scalars"])
