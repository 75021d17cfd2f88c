"""A recorder that is too slow, or told to end: nothing is missing that is not counted."""

import signal
import subprocess
import sys
import time
from unittest.mock import patch

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop.cli import commands
from teleop.errors import TeleopError
from teleop.launch import launcher
from teleop.launch.supervisor import Supervisor, wait_for_exit
from teleop.link import Link, ReceivedMessage, listener
from teleop.link.listener import Listener
from teleop.messages.messages import LoopReport, TendonState
from teleop.messages.topics import REPORT, STATE, TENDONS, TOPICS, Role
from teleop.recording import recorder as recorders
from teleop.recording.command import format_status
from teleop.recording.reader import open_recording, read_columns
from teleop.recording.recorder import GRACE_NS, SILENCE_NS, Recorder
from teleop.recording.writer import RecordConfig, RecordingWriter
from tests.teleop.link.bench import free_config, wait_until
from tests.teleop.recorded import START_NS, start
from tests.tick.memory_link import Sample

MS = 1_000_000
SENDER = 7


class Bench:
    """A side that publishes states, a recorder with a slow writer, and a clock that both use."""

    def __init__(self, folder, write_ns):
        self.now_ns, self.sent, self.reports, self.present = START_NS, 0, 0, True
        self.lag_ns = 0  # the longest
        with patch("teleop.link.listener.now_ns", self.clock):
            self.listener = Listener(lambda *_: 1)
            self._stores = {topic: self.listener.store(topic) for topic in TOPICS}
        config = RecordConfig(directory=str(folder), chunk_s=0.01, compression="none")
        self.writer = RecordingWriter(config, "bench", START_NS)
        write = self.writer.write

        def slowly(messages, now_ns):
            write(messages, now_ns)
            self.now_ns += write_ns * len(messages)

        self.writer.write = slowly
        self.recorder = Recorder(self.listener, self.writer, lambda *_: self.present)

    def clock(self):
        return self.now_ns

    def publish(self, arrives):
        """Send a state; it arrives or is lost on the way."""
        self.sent += 1
        if arrives:
            self._store(STATE, STATE.message().pack(SENDER, self.sent, self.now_ns))

    def report(self, ended):
        """Say how much was sent."""
        self.reports += 1
        sent = [0] * 16
        sent[TOPICS.index(STATE)] = self.sent
        report = LoopReport(role=Role.SLAVE, ended=ended, sent=tuple(sent))
        self._store(REPORT, report.pack(SENDER, self.reports, self.now_ns))

    def step(self):
        """Let the recorder take one batch."""
        self.recorder.step(self.clock)
        self.lag_ns = max(self.lag_ns, self.recorder.lag_ns)

    def end(self):
        """Tell the recorder to end; return how many messages it says are missing."""
        stop_ns = self.now_ns
        while not self.recorder.is_done(stop_ns, self.now_ns):
            self.step()
            self.now_ns += 20 * MS
        missing = self.recorder.finish()
        self.writer.close()
        return missing

    def _store(self, topic, data):
        with patch("teleop.link.listener.now_ns", self.clock):
            self._stores[topic](Sample(data))


@patch.object(listener, "CAPACITY_MIN", 8)
@patch.object(listener, "BACKLOG_S", 0.02)
@patch.object(recorders, "BATCH", 5)
@settings(max_examples=20)
@given(
    st.lists(st.booleans(), min_size=1, max_size=120), st.integers(0, 3 * MS), st.integers(1, 30)
)
def test_whatever_is_lost_or_too_slow_written_and_missing_are_all_that_was_sent(
    tmp_path_factory, arrivals, write_ns, every
):
    """The first is not lost: with it the recording begins."""
    bench = Bench(tmp_path_factory.mktemp("slow"), write_ns)
    for k, arrives in enumerate([True, *arrivals]):
        bench.publish(arrives)
        if k % every == 0:
            bench.step()
        bench.now_ns += MS
    bench.report(ended=1)
    bench.present = False
    missing = bench.end()
    info = open_recording(bench.writer.path)
    assert info.messages["state"] + info.lost["state"] == bench.sent
    assert missing == info.lost["state"] == bench.writer.gaps.total
    assert info.messages["state"] == len(read_columns(bench.writer.path, "state"))
    assert bool(missing) == any("missing" in line for line in info.doubts)


@patch.object(recorders, "BATCH", 5)
def test_a_backlog_is_shown_and_written_to_its_end_however_long_that_takes(tmp_path):
    bench = Bench(tmp_path, write_ns=50 * MS)  # twenty messages a second
    for _ in range(200):
        bench.publish(arrives=True)
        bench.now_ns += MS
    bench.report(ended=1)
    bench.present = False
    assert bench.end() == 0
    assert open_recording(bench.writer.path).messages["state"] == 200
    assert bench.lag_ns > 9_000 * MS
    assert bench.writer.lag_max_s > 9.0
    assert format_status(10_780 * MS, 0) == "recorder 10.8 s behind"
    assert "3 missing" in format_status(bench.lag_ns, 3)


def test_a_side_that_leaves_without_a_word_is_waited_for_and_named(tmp_path):
    bench = Bench(tmp_path, 0)
    bench.publish(arrives=True)
    bench.report(ended=0)
    bench.step()
    bench.present = False
    began_ns = bench.now_ns
    assert bench.end() == 0
    assert bench.now_ns - began_ns > SILENCE_NS
    info = open_recording(bench.writer.path)
    assert info.unfinished == ("slave",)
    assert "the end of the slave may be missing" in info.doubts[0]


def test_a_session_that_goes_on_does_not_keep_the_recorder(tmp_path):
    bench = Bench(tmp_path, 0)
    bench.publish(arrives=True)
    bench.report(ended=0)
    stop_ns = bench.now_ns
    while not bench.recorder.is_done(stop_ns, bench.now_ns):
        bench.step()
        bench.now_ns += 20 * MS
        bench.publish(arrives=True)
    assert bench.now_ns - stop_ns < 2 * GRACE_NS
    assert bench.recorder.finish() == 0
    bench.writer.close()
    assert open_recording(bench.writer.path).unfinished == ()


def test_missing_messages_are_told_and_end_the_command_with_exit_code_1(tmp_path):
    config = free_config()
    process = start("record", config, f"--out={tmp_path}", "--set=session=bench")
    assert process.stdout.readline().startswith("recording session")
    with Link(config, "bench", Role.SLAVE) as slave:
        wait_until(lambda: slave.has_listener(STATE))
        time.sleep(0.2)
        for k in (1, 2, 5):
            slave.publish_raw(STATE, STATE.message().pack(slave.nonce, k, k))
        time.sleep(0.2)
    process.send_signal(signal.SIGTERM)
    said, complaint = process.communicate(timeout=20.0)
    assert process.returncode == 1
    assert "2 messages are missing (2 state)" in complaint
    assert complaint.count("\n") == 1
    assert "2 messages are missing (2 state)" in said


TELL_AND_END = (
    "import signal, sys, time\n"
    "def end(*_):\n"
    "    for k in range(4):\n"
    "        time.sleep(0.15)\n"
    "        print(chr(5) + f'recorder {k}.0 s behind', flush=True)\n"
    "    print('teleop: 3 messages are missing', flush=True)\n"
    "    sys.exit(1)\n"
    "signal.signal(signal.SIGTERM, end)\n"
    "print('here', flush=True)\n"
    "while True: signal.pause()\n"
)


def test_the_launcher_waits_for_a_recorder_that_makes_progress_and_ends_with_its_exit_code(
    tmp_path, monkeypatch
):
    said = []
    family = Supervisor(tmp_path, lambda _name, line: said.append(line))
    spawn = subprocess.Popen
    monkeypatch.setattr("teleop.launch.supervisor._DRAINING_TIMEOUT_S", 0.4)
    monkeypatch.setattr("teleop.launch.supervisor._EXIT_TIMEOUT_MAX_S", 0.1)
    monkeypatch.setattr(
        "teleop.launch.supervisor.subprocess.Popen",
        lambda _words, **options: spawn([sys.executable, "-c", TELL_AND_END], **options),
    )
    child = family.start("record", [])
    wait_until(lambda: "here" in said)
    child.process.terminate()
    assert wait_for_exit(child)
    child.join_readers()
    assert child.status == "recorder 3.0 s behind"
    out = launcher._combine_summaries(family, None, "SIGINT")
    assert (out.exit_code, out.reason) == (1, "recorder: 3 messages are missing")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A recording of three chunks, and its length after each of them."""
    lengths = []
    config = RecordConfig(
        directory=str(tmp_path_factory.mktemp("whole")), chunk_s=0.01, compression="none"
    )
    with RecordingWriter(config, "demo", START_NS) as writer:
        for k in range(3):
            stamp_ns = START_NS + (k + 1) * 10 * MS
            message = TendonState(
                tendons=1, time_s=0.01 * k, proximal_tension=(1.0 + k, *[0.0] * 15)
            )
            data = message.pack(SENDER, k, stamp_ns)
            writer.write([ReceivedMessage(TENDONS, data, stamp_ns, SENDER, k, stamp_ns)], stamp_ns)
            lengths.append(writer.path.stat().st_size)
    return writer.path.read_bytes(), lengths


@pytest.mark.parametrize(
    ("words", "how"),
    [
        (["recordings", "to-ros2", "{}", "--out", "{}.bag"], "damaged"),
        (["replay", "{}", "--speed", "1000"], "truncated"),
        (["view", "{}", "--view", "none"], "damaged"),
        (["estimate", "{}", "--fit"], "truncated"),
        (["diagnose", "{}", "--out", "{}.diagnosis"], "truncated"),
    ],
)
def test_every_command_says_what_is_wrong_with_a_recording(tmp_path, whole, words, how, capsys):
    """Whatever they make of so few samples: in one line, what, and what could be read."""
    path = tmp_path / "a.mcap"
    content, lengths = bytearray(whole[0]), whole[1]
    if how == "damaged":
        content[lengths[2] - 600] ^= 1
    path.write_bytes(content[: lengths[2] - (how == "truncated") * 600])
    link = free_config()
    ends_of = ["--set", f"link.master={link.master}", "--set", f"link.slave={link.slave}"]
    further = ends_of if words[0] in ("replay", "view") else []
    commands.main([word.format(path) for word in words] + further)
    said = [line for line in capsys.readouterr().err.splitlines() if how in line]
    assert len(said) == 1
    assert said[0].startswith("WARNING: ")
    assert "could be read" in said[0]


def test_of_a_recording_without_one_whole_chunk_nothing_is_read(tmp_path, whole):
    content = bytearray(whole[0])
    content[whole[1][0] - 600] ^= 1
    (tmp_path / "a.mcap").write_bytes(content)
    with pytest.raises(TeleopError, match=r"is damaged before byte .* nothing could be read"):
        open_recording(tmp_path / "a.mcap")
