"""An emergency stop of a rig whose motors have a stop of their own."""

import pytest

from slave.process import CalibrationHistory
from teleop.link import ReceivedMessage
from teleop.messages.messages import EmergencyStop, encode_text
from teleop.messages.topics import STATE, STOP, Role
from teleop.remote.requests import CALL, RESET
from teleop.runtime.clock import now_ns
from teleop.session.state_machine import Reason, State
from tests.slave.test_process import (
    CONFIG,
    START,
    FakeLink,
    FakeRig,
    StoppableRig,
    side_of,
    started,
)

FELL_BACK = -0.0007  # [m] of the motor while it has no power
HELD = START + 0.0005  # [m] where a calibration left it


class Bench:
    """A slave on a `StoppableRig`, driven tick by tick."""

    def __init__(self, rig=None, past=None, config=CONFIG):
        self.rig, self.line = rig or StoppableRig(falls_by=FELL_BACK), FakeLink()
        self.slave, clock = started(self.rig, self.line, lambda: False, past=past, config=config)
        self._ticks, self._calls = iter(clock), 0

    def run_on(self, count):
        for _ in range(count):
            self.slave.tick(next(self._ticks))

    def call(self, action, **settings):
        self._calls += 1
        message = EmergencyStop(
            role=Role.REMOTE, action=action, text=encode_text("a nurse"), **settings
        )
        data = message.pack(77, self._calls, now_ns())
        self.line.heard = [ReceivedMessage(STOP, data, now_ns(), 77, self._calls, now_ns())]

    def reset(self):
        self.call(RESET, side=Role.SLAVE, number=self.line.of(STATE)[-1].stops)

    @property
    def side(self):
        return side_of(self.slave)


def off():
    bench = Bench(StoppableRig(encoder=None))
    bench.run_on(10)
    return bench


def ready(past=None):
    bench = Bench(past=past)
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


def clutched():
    return under_a_master(State.CLUTCHED)


def faulty():
    return under_a_master(State.FAULT)


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
        (clutched, State.CLUTCHED),
        (holding, State.HOLDING),
        (faulty, State.FAULT),
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


def test_a_rig_without_a_stop_of_its_own_is_held():
    bench = Bench(FakeRig(), CalibrationHistory(now_ns(), (), (HELD,)))
    bench.call(CALL)
    bench.run_on(10)
    assert bench.side.state is State.STOPPED
    assert bench.rig.writes == [[HELD]] * 10
