"""A whole session that goes on although the monitor has demanded a calibration."""

from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from estimator.structs import view_struct
from teleop.session.state_machine import Reason, State
from tests.tick.session import HAND_ENGAGED, Session

DEMO = Path(__file__).parents[2] / "configs" / "demo.yaml"
RATE = 250  # [Hz]
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
        summary = session.slave.summarise()
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


@pytest.mark.parametrize(
    ("adapts", "changes", "at_s", "end_s"),
    [
        pytest.param(  # the sheath is as calibrated again
            False, (0.4, 1.0 / 1.4 - 1.0), (9.0, 24.0), 42.0, marks=pytest.mark.slow
        ),
        (True, (1.2, -0.45), (6.0, 27.0), 44.0),  # beyond what adaptation decides, and within
    ],
    ids=["back as calibrated", "adapted"],
)
def test_a_session_goes_on_while_its_sheath_has_degraded_and_recovers(
    adapts: bool, changes: tuple[float, float], at_s: tuple[float, float], end_s: float
) -> None:
    effects = ", ".join(
        f"{{type: friction_step, start: {start}, change: {change}}}"
        for start, change in zip(at_s, changes, strict=True)
    )
    settings = (
        *(*HAND_ENGAGED, f"rate_hz={RATE}", "slave.rig.period=0.004"),
        f"slave.rig.effects=[{effects}]",
        "slave.monitor.on_demand=degrade",
        f"slave.adaptation.enabled={str(adapts).lower()}",
    )
    with ExitStack() as stack:
        session = Session(stack, settings, file=DEMO)
        reasons, forces = [], []
        for k in range(round(end_s * RATE)):
            session.tick()
            state, reason = session.slave._outline()
            assert state is State.ENGAGED or k < 0.1 * RATE
            reasons.append(reason)
            forces.append(session.slave._slave.scratch["force"][0, 0])
            assert session.master._outline().state is state
    due = np.array(reasons) == Reason.CALIBRATION_DUE
    begun, ended = np.flatnonzero(np.diff(due)) / RATE
    assert at_s[0] < begun < at_s[1] < ended < end_s - 1.0
    t = np.arange(len(forces)) / RATE
    peak = {
        name: np.max(np.abs(forces)[(t > low) & (t < high)])
        for name, low, high in (("degraded", begun + 1.0, at_s[1]), ("after", ended + 1.0, end_s))
    }
    assert 0.0 < peak["degraded"] < 0.6 * peak["after"]
