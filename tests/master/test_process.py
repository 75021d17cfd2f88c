from dataclasses import replace
from functools import partial

import pytest

from master import loop
from master.config import MasterConfig
from master.device import DeviceFault, DeviceLost, HandState
from master.process import LATE_ANSWERS_MAX, RETRY_TICKS, MasterProcess
from teleop.errors import PeerError, TeleopError
from teleop.messages.messages import (
    Command,
    EmergencyStop,
    Setting,
    SlaveState,
    decode_text,
    encode_text,
    pad_values,
)
from teleop.messages.topics import (
    ANSWER,
    COMMAND,
    HAND,
    REPORT,
    SETTING,
    STATE,
    STOP,
    Role,
)
from teleop.remote.request_listener import CALL, RESET
from teleop.runtime import clock as runtime_clock
from teleop.runtime.clock import Grid
from teleop.session.loop_process import run
from teleop.session.state_machine import Reason, State, to_outline
from tests.fake_link import ON_THE_WAY, FakeLink, Until, receive
from tests.tick.clock import StandingClock


@pytest.fixture(autouse=True)
def clock(monkeypatch):
    ObedientLink.clock = StandingClock(monkeypatch)
    return ObedientLink.clock


class ObedientLink(FakeLink):
    """Answers as an obedient slave would."""

    role = Role.MASTER

    def __init__(self):
        super().__init__(STATE, 30_000_000)
        self.answering = True
        self.late = 0  # looks that an answer takes; 0 = it is there at once
        self.under_way, self.waits = [], 0
        self.waited = set()  # numbers of the commands whose answers were waited for
        self.told = {}  # what the slave says instead

    def publish_packet(self, topic, packet):
        stamp = super().publish_packet(topic, packet)
        self.clock.sleep(ON_THE_WAY)
        if topic is COMMAND and self.answering:
            self.under_way.append((self.late, self.answer(self.sent[-1][1])))
        return stamp

    def answer(self, command):
        asked = State(command.state)
        fields = {
            "state": asked if asked == State.ENGAGED else State.READY,
            "joints": 1,
            "echo_stamp_ns": command.stamp_ns,
            "force": pad_values((5.0,), 8),
            "force_low": pad_values((4.0,), 8),
            "force_high": pad_values((6.0,), 8),
            "answer_ns": 1000,
        }
        return SlaveState(**(fields | self.told))

    def wait(self, topic, deadline_ns):
        assert topic is STATE
        self.waits += 1
        self.waited.add(len(self.of(COMMAND)))
        if any(looks == 0 for looks, _ in self.under_way):
            self.clock.sleep(ON_THE_WAY)
            return True
        self.clock.sleep(max(0.0, (deadline_ns - self.clock.now()) * 1e-9))
        return False

    def take_latest(self, topic):
        assert topic is STATE
        here = [state for looks, state in self.under_way if looks == 0]
        self.under_way = [(looks - 1, state) for looks, state in self.under_way if looks]
        return self.take(here)


class Stylus:
    """A device that fails where it is told to, and keeps what is done to it."""

    axes = 1

    def __init__(self, read_fails_at=None, write_fails_at=None, error=DeviceFault):
        self.reads, self.forces, self.closed = 0, [], 0
        self.read_fails_at, self.write_fails_at, self.error = read_fails_at, write_fails_at, error

    def read(self, time_s):  # noqa: ARG002
        self.reads += 1
        if self.reads == self.read_fails_at:
            raise self.error("unplugged")
        return HandState((0.0,), (0.0,), engage=self.reads > 5)

    def write(self, force):
        if self.reads == self.write_fails_at:
            raise self.error("does not take forces")
        self.forces.append(force)

    def close(self):
        self.closed += 1


def session(device, line, rate_hz, stop=lambda: False):
    grid = Grid(rate_hz, stop, now=line.clock.now, sleep=line.clock.sleep)
    return MasterProcess(MasterConfig(), line, device, grid), grid


def driven(device, line=None, ticks=40, rate_hz=2000.0):
    line = ObedientLink() if line is None else line
    stop = Until(ticks)
    master, grid = session(device, line, rate_hz, stop)
    run(master, grid, stop.request)
    return master, line, stop


def ticking(line, device, rate_hz=1000.0):
    master, grid = session(device, line, rate_hz)
    ticks = iter(grid)

    def run_on(count):
        for _ in range(count):
            master.tick(next(ticks))

    return master, run_on


def test_a_session_reaches_the_hand_and_ends_without_force():
    device = Stylus()
    master, line, _ = driven(device)
    assert min(device.forces)[0] < -0.5
    assert device.forces[-1] == (0.0,)
    assert master.error is None
    assert len(line.of(HAND)) == 40
    assert line.of(HAND)[-1].force[0] == device.forces[-2][0]
    assert line.of(COMMAND)[-1] == Command()
    assert line.of(COMMAND)[-2].state == State.ENGAGED


@pytest.mark.parametrize("fails", ["read_fails_at", "write_fails_at"])
def test_whatever_goes_wrong_the_end_is_told_and_the_hand_left_without_force(fails):
    device, line = Stylus(**{fails: 20}, error=ZeroDivisionError), ObedientLink()
    with pytest.raises(ZeroDivisionError):
        driven(device, line)
    assert line.of(COMMAND)[-1] == Command()
    assert line.of(REPORT)[-1].ended == 1
    assert line.said()[-1] == "off: ended"
    assert fails == "write_fails_at" or device.forces[-1] == (0.0,)


def test_the_force_is_that_of_the_answer_to_the_tick_s_own_command():
    line, device = ObedientLink(), Stylus()
    _, run_on = ticking(line, device)
    run_on(60)
    assert device.forces[-1][0] < -0.1
    line.told = {"force": pad_values((-5.0,), 8), "force_low": pad_values((-6.0,), 8)}
    line.told["force_high"] = pad_values((-4.0,), 8)
    before = device.forces[-1][0]
    run_on(1)
    assert device.forces[-1][0] > before  # on its way there, as fast as forces may change


def test_a_wait_ends_at_its_time_though_states_keep_coming():
    class Flood(ObedientLink):
        def wait(self, topic, deadline_ns):  # noqa: ARG002
            self.clock.sleep(ON_THE_WAY)
            return True  # always something, never the answer

    line = Flood()
    line.late = 10**9
    master, run_on = ticking(line, Stylus(), rate_hz=100.0)
    run_on(5)
    assert master.summarise().overruns == 0


class Late(ObedientLink):
    """A link on which answers come some commands later."""

    commands = 2

    def publish_packet(self, topic, packet):
        stamp = super().publish_packet(topic, packet)
        if topic is COMMAND:
            answers = [*self.held, *self.under_way]
            there = max(0, len(answers) - self.commands)
            self.under_way, self.held = answers[:there], answers[there:]
        return stamp

    held = ()


def test_on_a_link_that_is_always_late_no_time_is_spent_waiting_but_now_and_then():
    line, device = Late(), Stylus()
    master, run_on = ticking(line, device)
    run_on(LATE_ANSWERS_MAX + 1)
    assert len(line.waited) == LATE_ANSWERS_MAX + 1
    run_on(RETRY_TICKS - LATE_ANSWERS_MAX - 1)
    assert len(line.waited) == LATE_ANSWERS_MAX + 1
    run_on(1)
    assert len(line.waited) == LATE_ANSWERS_MAX + 2
    run_on(RETRY_TICKS - 1)
    assert len(line.waited) == LATE_ANSWERS_MAX + 2
    assert device.forces[-1][0] < -0.5  # the newest state is rendered all the same
    assert master.summarise().latency_ms.n > RETRY_TICKS
    assert master.summarise().stages_us["all"].n == 0  # none was answered in its own tick
    line.commands, before = 0, len(line.waited)
    run_on(RETRY_TICKS + 10)
    assert len(line.waited) >= before + 10  # they are waited for again


@pytest.mark.parametrize(
    ("joints", "said"),
    [
        (3, ["WARNING: the device has 1 axes, the rig 3 joints: joints from 2 on are not moved"]),
        (1, []),
    ],
)
def test_axes_and_joints_that_do_not_match_are_told_once(joints, said):
    line = ObedientLink()
    line.told = {"joints": joints}
    driven(Stylus(), line, ticks=130, rate_hz=100.0)
    assert [text for text in line.said() if text.startswith("WARNING: the device")] == said


@pytest.mark.parametrize("fails", ["read_fails_at", "write_fails_at"])
def test_a_device_that_fails_ends_the_session_in_fault_and_without_force(fails):
    device = Stylus(**{fails: 20})
    master, line, stop = driven(device)
    assert isinstance(master.error, TeleopError)
    assert "haptic device: " in str(master.error)
    assert stop.reason == str(master.error)
    assert device.reads == 20
    if fails == "read_fails_at":
        assert device.forces[-1] == (0.0,)
    last = line.of(COMMAND)[-2]
    assert (last.state, last.reason) == (State.FAULT, Reason.DEVICE_FAULT)
    assert line.said()[-2:] == [f"fault: {Reason.DEVICE_FAULT.text}", f"off: {master.error}"]


def freezing(monkeypatch, phase, at, decided, what):
    """Have the process freeze after the decisions `at`, of one phase, as a SIGSTOP would."""
    whole = getattr(loop, phase)

    def run_phase(*args):
        verdict = whole(*args)
        decided.append(what(args))
        if len(decided) in at:
            ObedientLink.clock.sleep(0.05)
        return verdict

    monkeypatch.setattr(loop, phase, run_phase)


def test_a_process_that_froze_after_it_decided_decides_again(monkeypatch):
    decided = []
    freezing(monkeypatch, "compute_force", (30,), decided, lambda args: args[-1][0])
    device = Stylus()
    driven(device)
    assert decided[29] < -0.1
    assert device.forces[28][0] < -0.1
    assert device.forces[29] == (0.0,)


def test_one_that_froze_twice_remembers_the_force_that_it_wrote(monkeypatch):
    decided = []
    freezing(monkeypatch, "compute_force", (30, 31), decided, lambda args: args[-1][0])
    device = Stylus()
    _, line, _ = driven(device)
    assert [hand.force[0] for hand in line.of(HAND)] == [force for (force,) in device.forces[:-1]]


def test_one_that_froze_before_it_commanded_commands_what_it_then_knows(monkeypatch):
    decided = []
    freezing(monkeypatch, "compute_command", (30,), decided, lambda args: args[-1]["state"][0])
    device = Stylus()
    _, line, _ = driven(device)
    assert decided[29] == State.ENGAGED
    command = line.of(COMMAND)[29]
    assert (command.state, command.reason) == (State.HOLDING, Reason.PEER_SILENT)
    assert device.forces[29] == (0.0,)


class Changed(Stylus):
    """A device whose hand is changed by `change(number of the read)`."""

    def __init__(self, change):
        super().__init__()
        self.change = change

    def read(self, time_s):
        return replace(super().read(time_s), **self.change(self.reads))


def test_a_hand_that_let_go_is_without_force_in_that_tick_though_both_decisions_froze(monkeypatch):
    freezing(monkeypatch, "compute_command", (30, 31), [], lambda _: None)
    device = Changed(lambda n: {"engage": 5 < n < 30})
    _, line, _ = driven(device)
    assert device.forces[28][0] < -0.1
    assert device.forces[29] == (0.0,)
    assert line.of(COMMAND)[29].state != State.ENGAGED


def test_one_that_froze_while_it_waited_renders_nothing_old():
    class Frozen(ObedientLink):
        def wait(self, topic, deadline_ns):
            if len(self.of(COMMAND)) == 30:
                self.clock.sleep(0.1)
                return False
            return super().wait(topic, deadline_ns)

    device = Stylus()
    driven(device, Frozen())
    assert device.forces[28][0] < -0.1
    assert device.forces[29] == (0.0,)


class Plug(Stylus):
    """A device that is away for a while, and whose switch is held when it is back."""

    def __init__(self, away):
        super().__init__()
        self.away = away

    def read(self, time_s):
        hand = super().read(time_s)
        if self.reads in self.away:
            raise DeviceLost("pulled out")
        return hand


def test_a_device_that_is_looked_for_is_a_fault_told_once_and_the_master_goes_on():
    device = Plug(away=range(20, 60))
    master, line, stop = driven(device, ticks=100)
    assert master.error is None
    assert stop.reason == ""
    assert device.reads == 100
    states = [(State(c.state), Reason(c.reason)) for c in line.of(COMMAND)[:-1]]
    assert states[18][0] == State.ENGAGED
    # the switch is still held when it is back
    assert set(states[19:]) == {(State.FAULT, Reason.DEVICE_FAULT)}
    assert set(device.forces[20:]) == {(0.0,)}
    assert len(line.of(HAND)) == 60
    assert line.said()[-4:] == [
        f"fault: {Reason.DEVICE_FAULT.text}",
        "haptic device: pulled out",
        "haptic device: it is back; let go of everything, then engage",
        "off: ended",
    ]
    assert master.summarise().faults == ((Reason.DEVICE_FAULT, "pulled out"),)


def test_after_a_suspension_the_hand_is_lost_with_any_device(clock, monkeypatch):
    suspended_ns = [0]
    patch = partial(monkeypatch.setattr, runtime_clock.time, raising=False)
    patch("CLOCK_BOOTTIME", 7)
    patch("clock_gettime_ns", lambda _: clock.now() + suspended_ns[0])
    device, line = Stylus(), ObedientLink()
    master, run_on = ticking(line, device)
    run_on(40)
    assert device.forces[-1][0] < -0.1
    suspended_ns[0] = 5 * 10**9
    run_on(20)
    assert set(device.forces[40:]) == {(0.0,)}  # the switch is still held
    states = {(State(c.state), Reason(c.reason)) for c in line.of(COMMAND)[40:]}
    assert states == {(State.FAULT, Reason.DEVICE_FAULT)}
    told = "haptic device: the machine was suspended for 5.0 s: start or engage again"
    assert sum(text.startswith(told) for text in line.said()) == 1
    assert master.error is None
    assert device.reads == 59


def test_a_second_master_ends_the_session():
    line = ObedientLink()
    line.conflict = "it has a master already"
    device = Stylus()
    master, _, stop = driven(device, line, ticks=200, rate_hz=100.0)
    assert isinstance(master.error, PeerError)
    assert stop.reason == line.conflict
    assert device.forces[-1] == (0.0,)


def test_a_call_for_a_stop_is_obeyed_in_the_tick_told_with_its_words_and_reset():
    device, line = Stylus(), ObedientLink()
    master, run_on = ticking(line, device)

    def asked(action, ticks=1, **fields):
        message = EmergencyStop(role=Role.REMOTE, action=action, **fields)
        line.heard = [receive(STOP, message)]
        run_on(ticks)
        assert device.forces[-1] == (0.0,)
        return to_outline(master.memory.session)

    run_on(30)
    assert device.forces[-1][0] < 0.0
    assert asked(CALL, text=encode_text("a nurse")).state == State.STOPPED
    assert line.of(COMMAND)[-1].state == State.STOPPED
    assert line.said()[-1] == f"stopped: {Reason.STOP_CALLED.text}: remote: a nurse"
    assert [decode_text(call.text) for call in line.of(STOP)] == ["remote: a nurse"]  # relayed
    run_on(20)
    stops = line.of(COMMAND)[-1].stops
    for other in (stops - 1, stops + 1):
        assert asked(RESET, side=Role.MASTER, number=other).state == State.STOPPED
    # the switch is still held
    reset = asked(RESET, ticks=20, side=Role.MASTER, number=stops)
    assert reset == (State.READY, Reason.RELEASE_FIRST)


def test_the_button_of_the_device_is_called_out_once_to_everybody():
    _, line, _ = driven(Changed(lambda n: {"stop": n in range(20, 25)}))
    (call,) = line.of(STOP)
    assert (call.role, call.action) == (Role.MASTER, CALL)
    assert decode_text(call.text) == Reason.EMERGENCY_STOP.text


def test_each_press_of_a_button_without_a_function_is_an_event_bounded_in_rate():
    """Button 2 is held for some reads, button 3 bounces at every one."""

    def press(n):
        return {"buttons": (2,) * (n in range(20, 60)) + (3,) * (n > 100 and n % 2)}

    line = ObedientLink()
    _, run_on = ticking(line, Changed(press))
    run_on(90)
    assert [text for text in line.said() if "button" in text] == ["button 2 pressed"]
    run_on(1000)
    assert 10 <= sum("button 3" in text for text in line.said()) <= 20
    assert 1 <= sum("came too fast" in text for text in line.said()) <= 3


def test_a_setting_is_changed_told_and_answered_and_a_refused_one_says_why():
    line = ObedientLink()
    _, run_on = ticking(line, Stylus())
    wishes = [("operator.position_scale", "0.1"), ("force.limit", "9"), ("force.scale", "99")]
    line.heard = [
        receive(SETTING, Setting(key=encode_text(key), value=encode_text(value)), k)
        for k, (key, value) in enumerate(wishes, start=1)
    ]
    run_on(1)
    answers = line.of(ANSWER)
    assert [(a.asker, a.setting_sequence, a.accepted) for a in answers] == [
        (77, 1, 1),
        (77, 2, 0),
        (77, 3, 0),
    ]
    texts = [decode_text(a.text) for a in answers]
    assert texts[0] == "operator.position_scale = 0.1"
    assert "force.limit: cannot be changed while the master runs (allowed: force.scale" in texts[1]
    assert "master.force.scale: must be 0 to 10" in texts[2]
    assert any("set: operator.position_scale = 0.1" in text for text in line.said())
