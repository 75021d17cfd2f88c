"""The launcher: its words, whom it can do without, and in which order things happen."""

import io
import itertools
import signal
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import pytest

from slave.config import SlaveConfig
from slave.rigs.replayed_data import ReplayedRigConfig
from studies.testbed.processes import wait_for_condition
from teleop.config.loading import ConfigDocument
from teleop.errors import TeleopError
from teleop.launch import launcher, watch
from teleop.launch.console import Console, KeyReader, format_status
from teleop.launch.supervisor import Supervisor
from teleop.link import MessageCounts, ReceivedMessage
from teleop.link.health import HealthConfig, LinkHealth
from teleop.messages.messages import (
    Event,
    Latency,
    LinkReport,
    LoopReport,
    SlaveState,
    encode_text,
    pad_values,
)
from teleop.messages.topics import COMMAND, EVENT, REPORT, STATE, STOP, Role
from teleop.remote.request_listener import CALL, RESET
from teleop.runtime import process
from teleop.runtime.clock import Percentiles
from teleop.runtime.status_line import StatusLine
from teleop.session.loop_meter import StageMeter
from teleop.session.state_machine import DetailedReason, Reason, State
from teleop.session.summary import (
    ForceError,
    LoopSummary,
    RigSummary,
    SessionSummary,
    find_fault,
    format_summary,
    read_child_summary,
)
from tests.root import ROOT

UNMEASURED = LinkHealth(HealthConfig()).build_summary(MessageCounts())


def loop(ticks=1000, latencies=0, **changes):
    """A loop's summary, as `teleop.session.loop_meter` makes it."""
    some = Percentiles(max(ticks, 1), 2.0, 3.0, 4.0, 5.0)
    ticks_in = {State.OFF: ticks - ticks // 2, State.ENGAGED: ticks // 2}
    summary = LoopSummary(
        role=Role.SLAVE,
        seconds=1.0,
        ticks=ticks,
        rate_hz=1000.0,
        overruns=3,
        lateness_max_ms=0.5,
        work_us=some if ticks else Percentiles(),
        answer_us=some,
        without_rig_us=some,
        latency_ms=some if latencies else Percentiles(),
        stages_us=StageMeter().build_summary(),
        received=999,
        lost=7,
        overwritten=5,
        rejected={"corrupted": 1, "foreign": 2},
        unknown=0,
        delayed=0,
        clock_jumps=0,
        restarts=0,
        gate={"PASSED": 1, "SPEED": ticks // 4},
        ticks_in=dict.fromkeys(State, 0) | ticks_in,
        faults=(DetailedReason(Reason.RIG_FAULT),) if ticks else (),
        final_state=State.OFF,
        reason=DetailedReason(Reason.RIG_FAULT, "unplugged"),
        not_usable=DetailedReason(Reason.NOT_USABLE, "no calibration"),
        ended_in=None,
        link=UNMEASURED,
    )
    return replace(summary, **changes)


def master(**changes):
    return loop(role=Role.MASTER, **changes)


FORCE_ERROR: ForceError = {
    "samples": 9, "full_scale_N": 1.1, "rmse_N": 0.13, "mean_N": 0.1, "max_N": 0.6,
    "inside_interval": 1.0, "rmse_percent": 11.6, "mean_percent": 9.0, "max_percent": 55.0,
    "pulled": False,
}  # fmt: skip
NO_BENCH = RigSummary(None, {})


# words


def test_the_summary_of_a_session_in_words():
    recorder = {
        "file": "a.mcap", "messages": {"state": 5, "hand": 6}, "missing": 1, "lag_max_s": 0.4,
    }  # fmt: skip
    children = {"slave": loop(rig=NO_BENCH), "master": master(latencies=9), "record": recorder}
    text = "\n".join(format_summary(SessionSummary(children)))
    for words in (
        "received 999, lost 7, rejected 3",
        f"1 fault, last: {Reason.RIG_FAULT.text}",
        "speed 25.0 % of the ticks",
        "command to force p50 2.00 ms",
        "no distal tension measured",
        "a.mcap: 11 messages, 1 missing, at most 0.4 s behind",
    ):
        assert words in text


def test_a_summary_that_is_read_from_its_file_is_the_one_that_was_written(tmp_path):
    adapted = RigSummary(FORCE_ERROR, {"coarse_reads": 3}, ("K of joint 1, tendon a: 1.21",))
    rigs = itertools.cycle([None, NO_BENCH, adapted])
    path = tmp_path / "slave.json"
    for reason, rig in zip(Reason, rigs, strict=False):
        ended_in = DetailedReason(reason, "joint 1: tendon a")
        written = loop(
            rig=rig,
            ended_in=ended_in,
            degraded=DetailedReason(Reason.CALIBRATION_DUE, "joint 1"),
            stopped="SIGINT",
            realtime=("memory locked",),
        )
        process.write_summary(path, written.to_json())
        assert read_child_summary("slave", path) == written


def test_a_summary_in_a_file_has_names_and_texts_in_an_order_of_its_own():
    """Programs of users read it."""
    content = loop(rig=RigSummary(FORCE_ERROR, {"coarse_reads": 3})).to_json()
    assert list(content) == [
        "role", "seconds", "ticks", "rate_hz", "overruns", "lateness_max_ms", "work_us",
        "answer_us", "without_rig_us", "latency_ms", "stages_us", "received", "lost", "overwritten",
        "rejected", "unknown", "delayed", "clock_jumps", "restarts", "gate", "ticks_in", "faults",
        "final_state", "reason", "not_usable", "ended_in", "link", "force_error", "rig", "friction",
        "degraded", "degraded_ticks", "stopped", "realtime",
    ]  # fmt: skip
    assert (content["role"], content["final_state"], content["ended_in"]) == ("slave", "off", "")
    assert content["faults"] == [Reason.RIG_FAULT.text]
    assert content["reason"] == f"{Reason.RIG_FAULT.text}: unplugged"
    assert list(content["ticks_in"]) == [state.name.lower() for state in State]
    assert content["work_us"] == {"n": 1000, "p50": 2.0, "p99": 3.0, "p99_9": 4.0, "max": 5.0}
    assert content["force_error"] == FORCE_ERROR
    assert content["rig"] == {"coarse_reads": 3}
    assert loop(rig=NO_BENCH).to_json()["force_error"] is None
    assert not {"force_error", "rig"} & master().to_json().keys()
    session = SessionSummary({"slave": loop(), "record": None}, "SIGINT", 1).to_json()
    assert session == {"slave": loop().to_json(), "record": None, "reason": "SIGINT",
                       "exit_code": 1}  # fmt: skip


def test_a_session_that_was_never_usable_or_ended_in_a_fault_is_told_from_a_good_one():
    never = loop(ticks_in=dict.fromkeys(State, 0) | {State.OFF: 9})
    assert find_fault([loop(), master()]) == ""
    assert find_fault([loop(ticks=0)]) == ""
    assert find_fault([never]) == (
        f"the slave was never usable: {Reason.NOT_USABLE.text}: no calibration"
    )
    afar = {"ended_in": DetailedReason(Reason.PEER_FAULT)}
    broken = {"ended_in": DetailedReason(Reason.TENDON_BROKEN, "joint 1, tendon a")}
    said = f"ended the session: {Reason.TENDON_BROKEN.text}: joint 1, tendon a"
    assert find_fault([loop(**broken), master(**afar)]) == f"a fault of the slave {said}"
    assert find_fault([loop(**afar), master(**broken)]) == f"a fault of the master {said}"
    assert Reason.PEER_FAULT.text in find_fault([loop(), master(**afar)])


def test_a_killed_side_is_named_and_one_that_never_ran_is_not():
    killed = SessionSummary({"slave": loop(rig=NO_BENCH), "master": None})
    assert format_summary(killed)[-2:] == [
        "master    left no summary (killed?)",
        "force     no distal tension measured to compare the estimate with",
    ]
    assert format_summary(SessionSummary({})) == []
    assert format_summary(SessionSummary({"slave": loop(ticks=0), "master": master(ticks=0)})) == []


def test_the_status_of_a_session_grows_with_what_is_known():
    assert format_status({}, None).plain == "waiting for the master │ slave starting"
    assert format_status({}, None, insecure=True).plain.startswith("INSECURE │ waiting")
    reports = {
        Role.MASTER: LoopReport(state=State.ENGAGED, rate_hz=999.6, latency_p50_ns=2_000_000),
        Role.SLAVE: LoopReport(rate_hz=1000, lost=2, rejected=1),
    }
    state = SlaveState(joints=2, force=pad_values((1.0, -2.5), 8))
    text = format_status(reports, state).plain
    for words in ("ENGAGED", "force 1.0 -2.5 N", "1000 / 1000 Hz", "latency 2.00 ms", "lost 3"):
        assert words in text
    latency = Latency(answered=5, p50_ns=(0, 0, 0, 0, 380_000), p99_ns=(0, 0, 0, 0, 500_000))
    assert "latency 0.38 ms (99 %: 0.50)" in format_status(reports, state, latency).plain
    # none was answered in its own tick: what there is, is the round trip
    assert "latency 2.00 ms" in format_status(reports, None, Latency()).plain
    held = LinkReport(
        role=Role.MASTER, round_trip_ns=5_200_000, jitter_ns=300_000, loss=0.31, scale=0.6,
        reason=Reason.LINK_LOSS, holds=1,
    )  # fmt: skip
    text = format_status({}, None, None, "recorder 0.4 s behind", {Role.MASTER: held}).plain
    assert f"link 5.2 +- 0.3 ms, loss 31.0 %: {Reason.LINK_LOSS.text}" in text
    assert ", held" in text
    assert text.endswith("recorder 0.4 s behind")


def console_on(stream):
    return Console(StatusLine(stream), clock=lambda: "12:34:56.7")


def test_lines_have_their_time_and_their_source_and_repeats_are_counted():
    stream = io.StringIO()
    console = console_on(stream)
    for _ in range(17):
        console.say("slave", "waiting for the master")
    console.say("master", "ready")
    console.say("slave", "ready")
    for _ in range(3):
        console.say("master", "off")
    console.finish()
    assert stream.getvalue().splitlines() == [
        "12:34:56.7 [slave] waiting for the master",
        "12:34:56.7 [master] ready",
        "12:34:56.7 [slave] waiting for the master (17 times)",
        "12:34:56.7 [slave] ready",
        "12:34:56.7 [master] off",
        "12:34:56.7 [master] off (3 times)",
    ]


# what is heard


def heard(topic, message):
    return ReceivedMessage(topic, message.pack(1, 1, 0), 0, 1, 1, 0)


def event(role, state, text):
    return heard(EVENT, Event(role=role, state=state, text=encode_text(text)))


def test_what_is_not_understood_neither_steers_the_terminal_nor_ends_the_session():
    hearing = watch.SessionMonitor()
    assert hearing.take([event(Role.SLAVE, State.OFF, "off")]) == [("slave", "off")]
    (line,) = hearing.take([event(9, State.READY, "a\x1b[2Jb\nc\u202ed\x00e")])
    assert line == ("role_9", "a [2Jb c d e")
    assert hearing.take([heard(REPORT, LoopReport(role=9))]) == []
    assert not hearing.running


def test_a_session_runs_when_both_loops_have_reported():
    hearing = watch.SessionMonitor()
    for role, running in ((Role.SLAVE, False), (Role.SLAVE, False), (Role.MASTER, True)):
        hearing.take([heard(REPORT, LoopReport(role=role))])
        assert hearing.running == running


# children


@pytest.fixture
def family(tmp_path, monkeypatch):
    """A supervisor whose children run the Python given in place of arguments."""
    said = []
    family = Supervisor(tmp_path, lambda name, line: said.append((name, line)))
    family.said = said
    program = tmp_path / "python"
    program.write_text(f'#!/bin/sh\nshift 4\nexec {sys.executable} -c "$@"\n')
    program.chmod(0o755)
    monkeypatch.setattr("teleop.runtime.process.sys.executable", str(program))
    yield family
    family.stop(list(family.children))


COMPLAIN = "print('teleop: no room'); raise SystemExit({})"


def ended(family, name, code):
    family.start(name, [code])
    assert wait_for_condition(lambda: family.children[name].exit_code is not None, 20.0)


@pytest.mark.parametrize("name", ["view", "record"])
def test_a_session_goes_on_without_a_viewer_or_recorder_and_says_so_once(family, name):
    ended(family, name, COMPLAIN.format(1))
    assert family.find_failed_child() is None
    assert family.find_failed_child() is None
    ((who, line),) = family.said
    assert who == name
    assert line.startswith("no room; the session goes on")
    assert ("teleop view" in line) == (name == "view")  # how to start it again


ANNOUNCE = "print('Web view: http://127.0.0.1:1/', flush=True)\nprint(chr(6), flush=True)\n"


@pytest.mark.real_time
@pytest.mark.parametrize(
    ("then", "why"),
    [("raise SystemExit(1)", "ended with exit code 1"), ("__import__('signal').pause()", "hung")],
)
def test_a_view_that_worked_is_started_again_in_one_line(family, monkeypatch, then, why):
    monkeypatch.setattr("teleop.launch.supervisor._HEARTBEAT_TIMEOUT_S", 1.0)
    first = family.start("view", [ANNOUNCE + then])

    def again():
        assert family.find_failed_child() is None
        return any("started again" in line for _, line in family.said)

    assert wait_for_condition(again, 30.0)
    assert family.children["view"].process.pid != first.process.pid
    assert family.children["view"].arguments == first.arguments
    (_, announced), (who, line) = family.said[:2]
    assert announced == "Web view: http://127.0.0.1:1/"
    assert who == "view"
    assert why in line
    assert line.endswith("xdg-open http://127.0.0.1:1/")


@pytest.mark.real_time
def test_a_view_that_computes_with_short_rests_is_not_taken_for_hung(family, monkeypatch):
    """As one does that compiles on a loaded machine, for longer than the time between beats."""
    monkeypatch.setattr("teleop.launch.supervisor._HEARTBEAT_TIMEOUT_S", 0.7)
    monkeypatch.setattr("teleop.launch.supervisor._HEARTBEAT_LATE_S", 0.2)
    work = "import time\nend = time.monotonic() + 2\nwhile time.monotonic() < end:\n"
    work += " sum(range(3000000))\n time.sleep(0.05)\nprint('done', flush=True)\n"
    child = family.start("view", [ANNOUNCE + work + "__import__('signal').pause()"])

    def is_done():
        assert family.find_failed_child() is None
        assert child.exit_code is None
        return ("view", "done") in family.said

    assert wait_for_condition(is_done, 30.0)


@pytest.mark.parametrize(("name", "code"), [("view", 2), ("slave", 1), ("master", 0)])
def test_a_vital_child_or_a_wrong_option_ends_the_session(family, name, code):
    ended(family, name, COMPLAIN.format(code))
    child = family.find_failed_child()
    assert (child.name, child.exit_code, child.complaint) == (name, code, "no room")
    assert family.said == []


def test_children_are_ended_in_order_and_know_their_launcher(family):
    code = (
        "import os, signal, sys\n"
        f"assert os.environ['{process.SUPERVISED_VARIABLE}'] == str(os.getppid())\n"
        "signal.signal(signal.SIGTERM, lambda *_: sys.exit('bye'))\n"
        "print('here', flush=True)\n"
        "signal.pause()\n"
    )
    for name in ("record", "slave", "master"):
        family.start(name, [code])
    assert wait_for_condition(lambda: len(family.said) == 3, 20.0)
    family.stop(launcher.SHUTDOWN_ORDER)
    assert family.said[3:] == [("master", "bye"), ("slave", "bye"), ("record", "bye")]


SAY_AND_END = (
    "import signal, sys, time\n"
    "def end(*_):\n"
    "    for _ in range({}):\n"
    "        time.sleep(0.1)\n"
    "        print('lowering the tensions', flush=True)\n"
    "    {}\n"
    "signal.signal(signal.SIGTERM, end)\n"
    "print('here', flush=True)\n"
    "while True: signal.pause()\n"
)


@pytest.mark.real_time
@pytest.mark.parametrize(("after", "killed"), [("sys.exit(0)", False), ("time.sleep(60)", True)])
def test_a_child_that_still_speaks_is_given_time_and_a_silent_one_is_killed(
    family, monkeypatch, after, killed
):
    monkeypatch.setattr("teleop.launch.supervisor._EXIT_TIMEOUT_S", 0.5)
    child = family.start("slave", [SAY_AND_END.format(8, after)])
    assert wait_for_condition(lambda: family.said == [("slave", "here")], 20.0)
    family.stop(["slave"])
    assert family.said.count(("slave", "lowering the tensions")) == 8
    assert (child.exit_code != 0) == killed
    assert any("was killed" in line for _, line in family.said) == killed


def test_a_child_that_only_speaks_is_killed_in_the_end(family, monkeypatch):
    monkeypatch.setattr("teleop.launch.supervisor._EXIT_TIMEOUT_MAX_S", 0.5)
    family.start("slave", [SAY_AND_END.format(1000, "pass")])
    assert wait_for_condition(lambda: family.said == [("slave", "here")], 20.0)
    family.stop(["slave"])
    assert any("was killed" in line for _, line in family.said)


class Mute:
    """A link on which no slave has answered yet, and a listener that hears of its calibration."""

    def subscribe_latest(self, _topic):
        pass

    def take_latest(self, _topic):
        return self

    message = None

    def drain(self):
        return [event(Role.SLAVE, State.OFF, "off: calibrating")]


class StopAt:
    def __init__(self, asked):
        self.left = asked

    def __call__(self):
        self.left -= 1
        return self.left < 0


def test_what_a_slave_says_while_it_starts_is_passed_on_and_counts_as_life(family, monkeypatch):
    stream = io.StringIO()
    child = family.start("slave", ["import signal; signal.pause()"])
    monkeypatch.setattr(watch, "START_S", 600.0)
    poll = partial(watch.Keyboard(KeyReader()).look, Mute())
    waiting = watch.SessionWatch(Mute(), Mute(), family, console_on(stream), StopAt(2), poll)
    assert waiting.wait_for_slave() is None
    assert stream.getvalue() == "12:34:56.7 [slave] off: calibrating\n"
    child.heard_s -= 300.0
    waiting.stop = StopAt(7)
    assert waiting.wait_for_slave() is None
    child.heard_s -= 600.0
    waiting.stop = StopAt(7)
    with pytest.raises(TeleopError, match="did not start"):
        waiting.wait_for_slave()


class Pressed:
    """Keys that are pressed one look after the other."""

    def __init__(self, *keys):
        self.keys = list(keys)

    def wait(self, _seconds):
        return self.keys.pop(0) if self.keys else ""


class Sides:
    """A link to two sides, each in the state and with the stops that a test says."""

    def __init__(self):
        self.states, self.stops, self.sent = {}, {}, []

    def take_latest(self, topic):
        side = {STATE: Role.SLAVE, COMMAND: Role.MASTER}[topic]
        state = self.states.get(side)
        told = (
            None if state is None else SimpleNamespace(state=state, stops=self.stops.get(side, 0))
        )
        return SimpleNamespace(message=told)

    def publish(self, topic, message):
        assert topic is STOP
        self.sent.append((message.action, message.side, message.number))


STOPPING = (CALL, 0, 0)


def test_a_stop_from_the_keyboard_is_called_until_both_sides_have_stopped():
    sides = Sides()
    look = partial(watch.Keyboard(Pressed(" ")).look, sides, 0.0)
    for _ in range(3):  # nobody is there yet
        look()
    sides.states[Role.SLAVE] = State.STOPPED
    look()
    sides.states[Role.MASTER] = State.READY
    look()
    assert sides.sent == [STOPPING] * 5
    sides.states[Role.MASTER] = State.STOPPED
    look()
    sides.states[Role.MASTER] = State.READY  # reset by another process
    look()
    assert len(sides.sent) == 5


def test_a_reset_from_the_keyboard_names_the_stops_that_it_takes_back_and_no_later_one():
    sides = Sides()
    sides.states = dict.fromkeys((Role.MASTER, Role.SLAVE), State.STOPPED)
    sides.stops = {Role.MASTER: 4, Role.SLAVE: 6}
    look = partial(watch.Keyboard(Pressed("r", "", " r")).look, sides, 0.0)
    look()
    assert sorted(sides.sent) == [(RESET, Role.MASTER, 4), (RESET, Role.SLAVE, 6)]
    sides.sent.clear()
    sides.stops[Role.SLAVE] = 7  # somebody has called anew
    sides.states[Role.MASTER] = State.READY
    look()
    assert sides.sent == []
    look()
    assert sides.sent == [STOPPING]


# the order of events


@pytest.mark.parametrize("given", ["as-built", "c.yaml"])
def test_the_calibration_is_a_file_wherever_a_child_runs_or_the_true_one(
    given, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    overrides = launcher.build_rig_overrides(None, Path(given))
    document = ConfigDocument.read(ROOT / "configs" / "arm.yaml", []).override(*overrides)
    expected = given if given == "as-built" else str(tmp_path / given)
    assert str(document.load(SlaveConfig, "slave").calibration) == expected


def test_data_are_replayed_as_their_mapping_says(tmp_path, monkeypatch, refused):
    monkeypatch.chdir(tmp_path)
    overrides = launcher.build_rig_overrides(Path("x.csv"), None, Path("lab.yaml"), 2)
    rig = ConfigDocument.read(None).override(*overrides).load(SlaveConfig, "slave").rig
    assert isinstance(rig, ReplayedRigConfig)
    assert (rig.file, rig.mapping, rig.run) == (tmp_path / "x.csv", tmp_path / "lab.yaml", 2)
    assert "--mapping, --run: require --replay" in refused("run", "--run", "2")


NO_HARDWARE = {  # section, entry, and the line of a side that opens it
    "slave": ("slave", "rig: {type: replayed, file: nowhere.csv}", "nowhere.csv: file not found"),
    "master": ("master", "device: {type: hid, find: /dev/hidraw99}", "no haptic device attached"),
}


@pytest.mark.parametrize("side", NO_HARDWARE)
def test_a_side_on_standby_opens_nothing_until_it_is_called(tmp_path, side):
    """Its hardware is not there: it ends with a line as soon as it opens it."""
    section, entry, complaint = NO_HARDWARE[side]
    config = tmp_path / "config.yaml"
    config.write_text(f"{section}:\n  {entry}\n")
    supervisor = Supervisor(tmp_path, lambda *_: None)

    child = supervisor.start(side, ["--config", str(config)], standby=True)
    waits = Path(f"/proc/{child.process.pid}/wchan")
    assert wait_for_condition(
        lambda: child.exit_code is not None or "pipe_read" in waits.read_text(), 120.0
    )
    assert child.exit_code is None, child.complaint
    supervisor.call(side)
    assert child.process.wait(30.0) != 0
    child.join_readers()
    assert complaint in child.complaint


WAITING = """
from teleop.runtime.process import wait_in_standby
print("waits", flush=True)
print("called" if wait_in_standby() else "not called", flush=True)
"""


def test_a_child_on_standby_ends_with_its_launcher_and_may_end_before(family):
    def start(count):
        child = family.start("slave", [WAITING], standby=True)
        assert wait_for_condition(lambda: family.said.count(("slave", "waits")) == count, 20.0)
        return child

    child = start(1)
    family.stop(["slave"])
    assert child.exit_code == -signal.SIGTERM
    assert child.process.stdin.closed
    child = start(2)
    child.process.stdin.close()  # its launcher ended
    assert child.process.wait(30.0) == 0
    child.join_readers()
    child = start(3)
    child.process.kill()
    child.process.wait()
    family.call("slave")  # no fault: whoever looks after it finds that it ended
    assert family.said[1:] == [("slave", "waits"), ("slave", "not called"), ("slave", "waits")]
