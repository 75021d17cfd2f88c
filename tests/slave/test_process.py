import math
import os
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from slave import loop, process, warm_up
from slave.calibration.calibration_file import Calibration
from slave.calibration.config import InitialiseConfig
from slave.calibration.initialisation import InitialiseResult
from slave.config import SlaveConfig, TendonConfig
from slave.process import CalibrationHistory, SlaveProcess
from slave.rig import RigFault, RigFinished, RigSample
from slave.rigs.simulated import SimulatedRig, SimulatedRigConfig
from teleop.errors import PeerError, TeleopError
from teleop.messages.messages import (
    MAX_JOINTS,
    Command,
    EmergencyStop,
    Setting,
    decode_text,
    encode_text,
    pad_values,
)
from teleop.messages.topics import (
    ANSWER,
    COMMAND,
    SETTING,
    STATE,
    STOP,
    TENDONS,
    Role,
)
from teleop.remote.request_listener import CALL, RESET, RequestListener
from teleop.remote.stop_socket import LocalRequest
from teleop.runtime.clock import EventClock, now_ns
from teleop.session.config import RunConfig
from teleop.session.loop_process import run
from teleop.session.state_machine import Reason, State, to_outline
from tests.fake_link import FakeLink, Until, receive
from tests.tick.clock import StandingClock

TENDON = TendonConfig(effective_friction=0.8)
CONFIG = SlaveConfig(tendons=(TENDON,))
START = 0.013  # [m] where the fake rig's encoder says its motor stands
PULL = 2e-5  # [m] of every command further than the last


@pytest.fixture(autouse=True)
def clock(monkeypatch):
    """Time stands still but for sleeping."""
    CommandingLink.clock = StandingClock(monkeypatch)
    return CommandingLink.clock


class CommandingLink(FakeLink):
    """Commands as a master would."""

    role = Role.SLAVE

    def __init__(self, pressed_after=5, rate_hz=1000.0):
        super().__init__(COMMAND, round(CONFIG.command_timeout * 1e9))
        self.pressed_after = pressed_after
        self.master_state = None  # whatever is pressed
        self.commanding = True
        self.period_ns, self.due_ns = round(1e9 / rate_hz), 0

    def wait(self, topic, deadline_ns):
        assert topic is COMMAND
        until_ns = min(self.due_ns, deadline_ns) if self.commanding else deadline_ns
        self.clock.sleep(max(0.0, (until_ns - self.clock.now()) * 1e-9))
        self.due_ns = self.clock.now() + self.period_ns
        return self.commanding

    def take_latest(self, topic):
        assert topic is COMMAND
        if not self.commanding:
            return self.take([])
        number = self.sequence + 1
        pressed = number > self.pressed_after
        command = Command(
            state=self.master_state or (State.ENGAGED if pressed else State.READY),
            position=pad_values((number * PULL,), MAX_JOINTS),
        )
        return self.take([command])

    def is_present(self, role, nonce=None):
        return role is Role.MASTER and nonce is None


class FakeRig:
    """A rig that fails where it is told to, and keeps what is done to it."""

    name = "bench"
    tendons = 1
    joints = ((0,),)
    starts_at_zero = False

    def __init__(
        self,
        encoder=START,
        read_fails_at=None,
        write_fails_at=None,
        advance_fails_at=None,
        error=RigFault,
    ):
        self.reads, self.writes, self.closed, self.after_fault = 0, [], 0, 0
        self.encoder, self.error, self.failed = encoder, error, False
        self.advances = 0
        self.read_fails_at, self.write_fails_at = read_fails_at, write_fails_at
        self.advance_fails_at = advance_fails_at

    def fail(self):
        self.failed = True
        raise self.error("the amplifier has tripped")

    def read(self, time_s):
        self.after_fault += self.failed
        self.reads += 1
        if self.reads == self.read_fails_at:
            self.fail()
        encoder = None if self.encoder is None else np.array([self.encoder])
        flicker = 1e-9 * (self.reads % 7)  # [N] the cell lives
        return (RigSample(time_s, np.array([5.0 + flicker]), encoder),)

    def write(self, proximal_displacement):
        self.after_fault += self.failed
        if self.write_fails_at is not None and len(self.writes) == self.write_fails_at:
            self.fail()
        self.writes.append(proximal_displacement.tolist())

    def advance(self):
        self.after_fault += self.failed
        self.advances += 1
        if self.advances == self.advance_fails_at:
            self.fail()

    def summarise(self):
        return {"reads": self.reads}

    def close(self):
        self.closed += 1


class StoppableRig(FakeRig):
    """Notes after how many writes it was stopped; without power its motor moves by `falls_by`."""

    def __init__(self, encoder=START, falls_by=0.0, stop_error=""):
        super().__init__(encoder)
        self.stops, self.falls_by, self.stop_error = [], falls_by, stop_error

    def emergency_stop(self):
        self.stops.append(len(self.writes))
        if self.stop_error:
            raise RigFault(self.stop_error)
        if self.encoder is not None:
            self.encoder = START + self.falls_by


def started(rig, line, stop, rate_hz=1000.0, history=None, config=CONFIG):
    wait = partial(line.wait, COMMAND)
    clock = EventClock(rate_hz, stop, wait, line.clock.now, line.clock.sleep)
    model = loop.build_rig_model(rig.joints, [TENDON.build_model()])
    return SlaveProcess(config, line, rig, model, clock, history), clock


def driven(rig, line=None, ticks=40, rate_hz=1000.0):
    line = CommandingLink(rate_hz=rate_hz) if line is None else line
    stop = Until(ticks)
    slave, clock = started(rig, line, stop, rate_hz)
    run(slave, clock, stop.request)
    return slave, line, stop


def ticking(rig, line, history=None):
    """Return a slave, and what lets it tick on."""
    slave, clock = started(rig, line, lambda: False, history=history)
    ticks = iter(clock)

    def run_on(count):
        for _ in range(count):
            slave.tick(next(ticks))

    return slave, run_on


def stop_message(action, sequence, sender=77, **settings):
    message = EmergencyStop(
        role=Role.REMOTE, action=action, text=encode_text("a nurse"), **settings
    )
    return receive(STOP, message, sequence, sender)


def side_of(slave):
    return to_outline(slave.memory.session)


def test_nothing_is_written_before_the_operator_has_engaged():
    rig = FakeRig()
    _, line, _ = driven(rig, CommandingLink(pressed_after=1000))
    assert rig.writes == []
    assert {state.state for state in line.of(STATE)} == {State.OFF, State.READY}
    assert all(math.isnan(m.commanded_displacement[0]) for m in line.of(TENDONS))


def test_earlier_samples_are_taken_over_at_ordinary_priority_and_the_loop_is_back_at_its_own(
    monkeypatch,
):
    """They may be those of minutes, and other real-time threads need the processor."""
    start, policies = loop.init_slave, []
    monkeypatch.setattr(
        loop, "init_slave", lambda *args: policies.append(os.sched_getscheduler(0)) or start(*args)
    )
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except OSError:
        pytest.skip("real-time scheduling is not permitted here")
    try:
        started(FakeRig(), CommandingLink(), Until(1))
        policies.append(os.sched_getscheduler(0))
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    assert policies == [os.SCHED_OTHER, os.SCHED_FIFO]


def test_engaged_the_motor_is_led_from_where_it_stands():
    rig = FakeRig()
    slave, line, _ = driven(rig)
    assert rig.writes[0] == pytest.approx([START], abs=1e-12)
    assert np.diff(rig.writes, axis=0)[:, 0] == pytest.approx(PULL, abs=1e-12)
    assert len(rig.writes) == 35
    assert [m.commanded_displacement[0] for m in line.of(TENDONS)[5:]] == [w for (w,) in rig.writes]
    assert slave.error is None


def test_the_end_is_told_and_is_not_engaged():
    _, line, _ = driven(FakeRig())
    *_, before, last = line.of(STATE)
    assert before.state == State.ENGAGED
    assert (last.state, last.reason, last.joints) == (State.OFF, Reason.NOT_USABLE, 0)
    assert [t.split(":")[0] for t in line.said()] == ["ready", "engaged", "off"]
    assert line.said()[-1] == "off: ended"


@pytest.mark.parametrize("fails", ["read_fails_at", "write_fails_at", "advance_fails_at"])
def test_a_rig_that_fails_ends_the_session_in_fault_and_is_left_alone(fails):
    rig = FakeRig(**{fails: 20})
    slave, line, stop = driven(rig)
    assert isinstance(slave.error, TeleopError)
    assert str(slave.error) == stop.reason == "rig: the amplifier has tripped"
    assert rig.after_fault == 0
    assert line.of(TENDONS)[-1].commanded_displacement[0] == rig.writes[-1][0]  # what was done
    for state in line.of(STATE)[-2:]:  # also the one that may be the only one seen
        assert (state.state, state.reason) == (State.FAULT, Reason.RIG_FAULT)
    assert line.said()[-2:] == [f"fault: {Reason.RIG_FAULT.text}", f"off: {slave.error}"]
    assert slave.summarise().reason.reason is Reason.RIG_FAULT


def test_a_command_is_answered_with_its_stamp_and_the_time_that_it_took():
    begin = now_ns()
    _, line, _ = driven(FakeRig())
    states = line.of(STATE)[:-1]
    assert [state.echo_stamp_ns for state in states] == line.stamps
    for state in states:
        assert 0 < state.answer_ns <= state.stamp_ns - state.echo_stamp_ns
    assert sum(state.answer_ns for state in states) < now_ns() - begin
    assert line.of(STATE)[-1].answer_ns == 0


def test_a_tick_that_no_command_asked_for_answers_none():
    line = CommandingLink()
    stop = Until(30)
    slave, clock = started(FakeRig(), line, stop)
    for number, tick in enumerate(clock, start=1):
        slave.tick(tick)
        line.commanding = number < 20
    states = line.of(STATE)
    assert [state.answer_ns > 0 for state in states] == [True] * 20 + [False] * 10
    assert {state.echo_stamp_ns for state in states[19:]} == {line.stamps[-1]}


class Witness(FakeRig):
    """A rig that notes when it is called, among what its line publishes."""

    def __init__(self, line, **fails):
        super().__init__(**fails)
        self.line = line

    def note(self, name):
        self.line.sent.append((name, None))

    def read(self, time_s):
        self.note("read")
        return super().read(time_s)

    def write(self, proximal_displacement):
        self.note("write")
        super().write(proximal_displacement)

    def advance(self):
        self.note("advance")
        super().advance()


def order(line):
    """What was done in each tick, as far as somebody waits for it."""
    told = ("read", "write", "advance", STATE)
    ticks = []
    for what, _ in line.sent:
        if what == "read":
            ticks.append([])
        if what in told and ticks:
            ticks[-1].append("answer" if what is STATE else what)
    return ticks


def test_the_answer_is_out_before_the_rig_is_advanced_once_a_tick():
    line = CommandingLink()
    driven(Witness(line), line)
    ticks = order(line)
    assert len(ticks) == 40
    assert ticks[:5] == [["read", "answer", "advance"]] * 5
    assert ticks[5:-1] == [["read", "write", "answer", "advance"]] * 34
    assert ticks[-1] == ["read", "write", "answer", "advance", "answer"]


class Foresighted(FakeRig):
    """A rig of known samples; of reads now and then none is given, or two, whatever was foreseen.

    With `tells` it says in advance which one the next read should give.
    """

    def __init__(self, tells):
        super().__init__()
        self.tells, self.given = tells, 0
        self.samples = [
            RigSample(1e-3 * k, np.array([5.0 + math.sin(0.3 * k)]), np.array([START + 1e-5 * k]))
            for k in range(100)
        ]

    def read(self, time_s):
        super().read(time_s)
        count = {5: 0, 9: 2}.get(self.reads % 11, 1)
        self.given += count
        return tuple(self.samples[self.given - count : self.given])

    def advance(self):
        super().advance()
        foreseen = self.samples[self.given]
        if (self.reads + 1) % 11 == 7:  # another one comes
            foreseen = replace(foreseen, proximal_tension=np.array([9.0]))
        return foreseen if self.tells else None


def test_what_is_estimated_in_advance_is_what_would_be_estimated_from_the_samples_that_come():
    told = []
    for tells in (False, True):
        _, line, _ = driven(Foresighted(tells))
        told.append([
            (t.time_s, t.distal_tension[0], t.distal_tension_low[0], t.elongation[0], t.front[0])
            for t in line.of(TENDONS)
        ])  # fmt: skip
    assert len(told[0]) > 35
    assert told[0] == told[1]
    assert len({tension for _, tension, *_ in told[0]}) > 20


def test_the_last_sample_ends_the_session_without_error():
    rig = FakeRig(read_fails_at=20, error=RigFinished)
    slave, line, stop = driven(rig)
    assert slave.error is None
    assert stop.reason == Reason.RIG_FINISHED.text
    assert rig.after_fault == 0
    for state in line.of(STATE)[-2:]:
        assert (state.state, state.reason) == (State.OFF, Reason.RIG_FINISHED)
    assert line.said()[-1] == f"off: {Reason.RIG_FINISHED.text}"


@pytest.mark.parametrize("fails", ["read_fails_at", "write_fails_at", "advance_fails_at"])
def test_whatever_else_goes_wrong_the_others_are_told(fails):
    line = CommandingLink()
    with pytest.raises(ZeroDivisionError):
        driven(FakeRig(**{fails: 20}, error=ZeroDivisionError), line)
    assert line.of(STATE)[-2].state == State.ENGAGED
    assert line.of(STATE)[-1].state == State.OFF
    assert line.said()[-1].startswith("off: ")


def freezing(monkeypatch, at, decided):
    """Have the process freeze after the decision of tick `at`, as a SIGSTOP would."""
    whole = loop.run_tick

    def tick(*args):
        verdict = whole(*args)
        decided.append(args[2]["gated_position"][0, 0])
        if len(decided) in at:
            CommandingLink.clock.sleep(0.05)
        return verdict

    monkeypatch.setattr(loop, "run_tick", tick)


@pytest.mark.parametrize("at", [(20,), (20, 21)])
def test_a_process_that_froze_after_it_decided_decides_again_and_moves_nothing(monkeypatch, at):
    decided = []
    freezing(monkeypatch, at, decided)
    rig = FakeRig()
    _, line, _ = driven(rig)
    assert decided[19] not in [written for (written,) in rig.writes]
    assert rig.writes[14] == rig.writes[13]
    assert Reason.PEER_SILENT in [state.reason for state in line.of(STATE)]


class Loaded(FakeRig):
    """A rig with a clock of its own, whose tendon is pulled and let go."""

    def read(self, time_s):
        (sample,) = super().read(time_s)
        tension = np.array([5.0 + 3.0 * math.sin(0.4 * self.reads)])
        return (RigSample(1e-3 * self.reads, tension, sample.proximal_displacement),)


def test_a_tick_that_is_taken_back_leaves_no_trace_in_the_estimates(monkeypatch):
    _, undisturbed, _ = driven(Loaded())
    freezing(monkeypatch, (20,), [])
    _, frozen, _ = driven(Loaded())
    told = [[m.distal_tension[0] for m in line.of(TENDONS)] for line in (undisturbed, frozen)]
    assert np.ptp(told[0]) > 1.0
    assert told[0] == told[1]


def test_a_second_slave_ends_the_session():
    line = CommandingLink()
    line.conflict = "it has a slave already"
    slave, _, stop = driven(FakeRig(), line, ticks=200, rate_hz=100.0)
    assert isinstance(slave.error, PeerError)
    assert stop.reason == line.conflict


def test_a_call_for_a_stop_holds_the_motors_until_it_is_reset_without_any_master_s_help():
    rig, line = FakeRig(), CommandingLink()
    slave, run_on = ticking(rig, line)

    def call(*words, **settings):
        line.heard = [stop_message(*words, **settings)]

    run_on(30)
    assert rig.writes[-1] != rig.writes[-2]
    call(CALL, 1)
    run_on(1)
    held = rig.writes[-1]
    assert side_of(slave) == (State.STOPPED, Reason.STOP_CALLED)
    assert line.said()[-1] == f"stopped: {Reason.STOP_CALLED.text}: remote: a nurse"
    run_on(50)  # the master goes on commanding
    stops = line.of(STATE)[-1].stops
    call(RESET, 2, side=Role.SLAVE, number=stops - 1)  # of a stop before this one
    run_on(1)
    call(RESET, 3, side=Role.MASTER, number=stops)
    run_on(1)
    call(RESET, 4, 78, side=Role.SLAVE, number=stops)  # by nobody who is there
    run_on(1)
    assert side_of(slave).state is State.STOPPED
    call(RESET, 5, side=Role.SLAVE, number=stops)
    run_on(50)
    assert all(written == held for written in rig.writes[-100:])
    assert side_of(slave) == (State.READY, Reason.PEER_NOT_READY)
    assert line.of(STATE)[-60].state == State.STOPPED


CALIBRATING = SlaveConfig(rig=SimulatedRigConfig(), initialise=InitialiseConfig(at_start=True))


def model_of(rig, line, stop_socket=None):
    requests = RequestListener(line, stop_socket)
    return process.prepare_rig_model(CALIBRATING, rig, line, requests, Until(9), RunConfig(), {})


def test_a_calibration_at_the_start_leaves_the_motors_held_from_the_first_tick_on(monkeypatch):
    rig, line = FakeRig(), CommandingLink(pressed_after=30)
    calibration = Calibration(rig="bench", joints=rig.joints, tendons=(TENDON,))
    held = START + 0.0004
    done = InitialiseResult(calibration, None, rig.read(0.0), (held,))
    monkeypatch.setattr(process, "initialise", lambda *_, **__: done)
    _, history = model_of(rig, line)
    slave, run_on = ticking(rig, line, history)
    run_on(20)
    assert side_of(slave).state is State.READY
    assert rig.writes == [[held]] * 20
    run_on(20)
    assert side_of(slave).state is State.ENGAGED
    assert np.abs(np.diff(rig.writes, axis=0)).max() == pytest.approx(PULL, abs=1e-12)


@pytest.mark.parametrize(
    ("error", "said"), [("", "a nurse$"), ("no power", "a nurse; rig: no power$")]
)
def test_a_stop_ends_a_calibration_at_the_start_and_stops_the_motors(monkeypatch, error, said):
    rig, line = StoppableRig(stop_error=error), CommandingLink()

    def never_calibrated(*_, stopped, **__):
        assert stopped() == ""
        line.heard = [stop_message(CALL, 1)]
        stopped()

    monkeypatch.setattr(process, "initialise", never_calibrated)
    with pytest.raises(TeleopError, match=rf"calibration given up: .*remote: {said}"):
        model_of(rig, line)
    assert rig.stops == [0]
    (told,) = line.of(STOP)  # the master may not have heard it
    assert told.action == CALL


@pytest.mark.parametrize(("commanding", "master"), [(True, "ready"), (False, "silent")])
def test_a_stop_during_a_calibration_says_what_the_master_does(monkeypatch, commanding, master):
    line, told = CommandingLink(), []
    line.commanding = commanding
    request = LocalRequest(is_reset=False, number=0, reason="smoke")
    local = SimpleNamespace(take=lambda: [request], is_asked=True, answer=told.append)
    monkeypatch.setattr(process, "initialise", lambda *_, stopped, **__: stopped())
    with pytest.raises(TeleopError, match="this machine: smoke"):
        model_of(StoppableRig(), line, local)
    assert told == [["slave stopped 0", f"master {master}"]]


@pytest.mark.parametrize(("kind", "stops"), [(FakeRig, None), (StoppableRig, [0])])
def test_under_a_master_that_is_stopped_nothing_is_calibrated(monkeypatch, kind, stops):
    rig, line = kind(), CommandingLink()
    line.master_state = State.STOPPED
    monkeypatch.setattr(process, "initialise", lambda *_, stopped, **__: stopped())
    with pytest.raises(TeleopError, match=r"calibration given up: .*emergency stop"):
        model_of(rig, line)
    assert getattr(rig, "stops", None) == stops


# --- an emergency stop of a rig whose motors have a stop of their own -----------------------------

FELL_BACK = -0.0007  # [m] of the motor while it has no power
HELD = START + 0.0005  # [m] where a calibration left it


class Bench:
    """A slave on a `StoppableRig`, driven tick by tick."""

    def __init__(self, rig=None, history=None):
        self.rig, self.line = rig or StoppableRig(falls_by=FELL_BACK), CommandingLink()
        self.slave, self.run_on = ticking(self.rig, self.line, history)
        self._calls = 0

    def call(self, action, **settings):
        self._calls += 1
        self.line.heard = [stop_message(action, self._calls, **settings)]

    def reset(self):
        self.call(RESET, side=Role.SLAVE, number=self.line.of(STATE)[-1].stops)

    @property
    def side(self):
        return side_of(self.slave)


def off():
    bench = Bench(StoppableRig(encoder=None))
    bench.run_on(10)
    return bench


def ready(history=None):
    bench = Bench(history=history)
    bench.line.master_state = State.READY
    bench.run_on(10)
    return bench


def calibrated():
    bench = ready(CalibrationHistory(now_ns(), (), (HELD,)))
    assert bench.rig.writes == [[HELD]] * 10
    return bench


def engaged():
    bench = Bench()
    bench.run_on(30)
    assert len(bench.rig.writes) > 10
    return bench


def under_a_master(state):
    bench = engaged()
    bench.line.master_state = state
    bench.run_on(10)
    return bench


def holding():
    bench = engaged()
    bench.line.commanding = False
    bench.run_on(60)
    return bench


@pytest.mark.parametrize(
    ("reached", "state"),
    [
        (off, State.OFF),
        (ready, State.READY),
        (calibrated, State.READY),
        (engaged, State.ENGAGED),
        (partial(under_a_master, State.CLUTCHED), State.CLUTCHED),
        (holding, State.HOLDING),
        (partial(under_a_master, State.FAULT), State.FAULT),
    ],
)
def test_a_stop_reaches_the_motors_once_from_every_state(reached, state):
    bench = reached()
    assert bench.side.state is state
    written = len(bench.rig.writes)
    bench.call(CALL)
    bench.run_on(1)
    assert bench.side == (State.STOPPED, Reason.STOP_CALLED)
    assert bench.rig.stops == [written]
    bench.call(CALL)
    bench.run_on(20)
    assert bench.rig.stops == [written]
    assert len(bench.rig.writes) == written


@pytest.mark.parametrize("reached", [ready, engaged])
def test_a_stop_after_a_reset_reaches_the_motors_again(reached):
    bench = reached()
    for number in (1, 2):
        bench.call(CALL)
        bench.run_on(2)
        assert len(bench.rig.stops) == number
        bench.reset()
        bench.run_on(2)
        assert bench.side.state is not State.STOPPED


def test_motors_move_on_from_where_they_are_after_the_stop():
    bench = engaged()
    written = len(bench.rig.writes)
    bench.call(CALL)
    bench.run_on(50)  # the master goes on commanding
    bench.reset()
    bench.line.master_state = State.READY
    bench.run_on(20)
    assert len(bench.rig.writes) == written  # reset alone moves nothing
    bench.line.master_state = State.ENGAGED
    bench.run_on(20)
    assert bench.rig.writes[written][0] == START + FELL_BACK
    assert bench.rig.stops == [written]


@pytest.mark.parametrize("with_dynamics", [False, True])
def test_effects_of_models_are_compiled_before_the_loop_begins(with_dynamics, monkeypatch):
    config = SlaveConfig()
    compiled = []
    monkeypatch.setattr(warm_up, "estimate", lambda *args: compiled.append(args[4]))
    warm_up.compile_session(config, with_dynamics)
    assert compiled == [None, True][: 1 + with_dynamics]


def test_a_request_is_answered_by_the_side_that_has_the_setting():
    rig, line = SimulatedRig(SimulatedRigConfig()), CommandingLink()
    _, run_on = ticking(rig, line)
    run_on(10)
    key = "slave.rig.joints.0.environment."
    wishes = (key + "stiffness", key + "exponent", "force.scale")
    for sequence, wish in enumerate(wishes, 1):
        setting = Setting(key=encode_text(wish), value=encode_text("800"))
        line.heard.append(receive(SETTING, setting, sequence))
    run_on(1)
    answers = line.of(ANSWER)
    assert [(a.role, a.asker, a.setting_sequence, a.accepted) for a in answers] == [
        (Role.SLAVE, 77, 1, 1),
        (Role.SLAVE, 77, 2, 0),
    ]
    assert decode_text(answers[0].text) == f"{key}stiffness = 800"
    assert line.said().count(f"set: {key}stiffness = 800") == 1
