"""A whole session that goes on although the monitor has demanded a calibration."""

from contextlib import ExitStack

import numpy as np
import pytest

from estimator.records import view_struct
from teleop.session.state_machine import Reason, State
from tests.tick.session import HAND_ENGAGED, Session

DEGRADE = ("slave.monitor.on_demand=degrade", "slave.monitor.degraded_speed=0.0002")


def run(session: Session, seconds: float) -> np.ndarray:
    """Tick; return where the coupling lets the tips go [m], shape (n, 4)."""
    tips = []
    for _ in range(round(1000 * seconds)):
        session.tick()
        tips.append(session.slave.memory.coupling.tip[:4].copy())
    return np.array(tips)


def misjudge(session: Session) -> None:
    """Let the monitor of the first tendon have found T_out 30 % too high, three times."""
    monitor = view_struct(session.slave._slave.memory["monitors"][0][:1])
    monitor.count, monitor.force_error = 3, 0.3
    monitor.errors[:3], monitor.uncertainties[:3] = 0.3, 0.01
    session.slave._checkpoint.save()


def outlines(session: Session) -> tuple[tuple[State, Reason], ...]:
    return session.master._outline(), session.slave._outline()


def test_both_sides_go_on_with_less_force_and_motion_and_say_why() -> None:
    with ExitStack() as stack:
        session = Session(stack, (*HAND_ENGAGED, *DEGRADE))
        fast = np.abs(np.diff(run(session, 0.6), axis=0)).max()
        assert outlines(session) == ((State.ENGAGED, Reason.NONE),) * 2
        misjudge(session)
        run(session, 0.55)
        assert outlines(session) == ((State.ENGAGED, Reason.CALIBRATION_DUE),) * 2
        assert session.master._states.packet.records["force_reduction"][0] == 0.5
        steps = np.abs(np.diff(run(session, 0.2), axis=0))
        assert 0.19e-6 < steps.max() < 0.21e-6 < fast  # ticks of 1 ms, a little uneven
        session.alter(lambda data: data[:-1], lambda data: data[:-1])
        run(session, 0.1)
        assert outlines(session) == ((State.HOLDING, Reason.PEER_SILENT),) * 2
        summary = session.slave.summary()
        assert summary.degraded_s == pytest.approx(0.78, abs=0.03)
        assert summary.degraded.text.startswith("sheath has changed its shape; calibrate again: j")


def test_as_configured_before_it_ends_the_session() -> None:
    with ExitStack() as stack:
        session = Session(stack)
        run(session, 0.3)
        misjudge(session)
        run(session, 0.05)
        assert outlines(session) == (
            (State.FAULT, Reason.PEER_FAULT),
            (State.FAULT, Reason.CALIBRATION_DUE),
        )
