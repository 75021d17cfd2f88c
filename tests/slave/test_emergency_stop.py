"""An emergency stop of a rig whose motors have a stop of their own."""

from teleop.clock import now_ns
from teleop.link import ReceivedMessage
from teleop.messages import EmergencyStop, text_bytes
from teleop.remote.requests import CALL, RESET
from teleop.session import State
from teleop.topics import STATE, STOP, Role
from tests.slave.test_process import START, FakeLink, FakeRig, side_of, started

FELL_BACK = -0.0007  # [m] of the motor while it has no power


class StoppableRig(FakeRig):
    """Counts its emergency stops; without power its motor is pulled back."""

    def __init__(self):
        super().__init__()
        self.stops = []

    def emergency_stop(self):
        self.stops.append(len(self.writes))
        self.encoder = START + FELL_BACK


def test_its_motors_stop_by_themselves_and_move_on_from_where_they_are_then():
    rig, line = StoppableRig(), FakeLink()
    slave, clock = started(rig, line, lambda: False)
    ticks = iter(clock)

    def call(action, sequence, **settings):
        message = EmergencyStop(
            role=Role.REMOTE, action=action, text=text_bytes("a nurse"), **settings
        )
        data = message.pack(77, sequence, now_ns())
        line.heard = [ReceivedMessage(STOP, data, now_ns(), 77, sequence, now_ns())]

    def run_on(count):
        for _ in range(count):
            slave.tick(next(ticks))

    run_on(30)
    written = len(rig.writes)
    assert written > 10
    call(CALL, 1)
    run_on(50)  # the master goes on commanding
    assert side_of(slave).state is State.STOPPED
    assert rig.stops == [written]
    assert len(rig.writes) == written
    stops = line.of(STATE)[-1].stops
    call(RESET, 2, side=Role.SLAVE, number=stops)
    line.master_state = State.READY
    run_on(20)
    assert len(rig.writes) == written  # reset alone moves nothing
    line.master_state = State.ENGAGED
    run_on(20)
    assert rig.writes[written][0] == START + FELL_BACK
    assert rig.stops == [written]
