"""A whole session on a link that gets worse, is cut, or whose clocks are set."""

import random
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import numpy as np
import pytest

from teleop.link.health import HealthConfig
from teleop.messages.messages import Command, Message, SlaveState
from teleop.session.state_machine import HOLD_LIMIT_S, Reason, State
from tests.tick.session import Session

HOUR_NS = 3_600_000_000_000
BOUNDS = HealthConfig(loss=0.3, hold_after=0.3, recover_after=0.3)


@contextmanager
def engaged(release_s: float, press_s: float) -> Iterator[Session]:
    """A session that is engaged; the switch is open from `release_s` to `press_s`."""
    engage = f"[[0.05, {release_s}], [{press_s}, 1e6]]"
    hand = (f"master.device.engage={engage}", "master.device.engage_period=1e6")
    with ExitStack() as stack:
        session = Session(stack, hand, BOUNDS)
        run(session, 0.5)
        assert states(session) == (State.ENGAGED, State.ENGAGED)
        yield session


def run(session: Session, seconds: float) -> list[tuple[Any, Any]]:
    """Tick; return the (state, reason) of master and slave after each tick."""
    out = []
    for _ in range(round(1000 * seconds)):
        session.tick()
        out.append((session.master._outline(), session.slave._outline()))
    return out


def states(session: Session) -> tuple[State, State]:
    return session.master._outline().state, session.slave._outline().state


def lost(data: bytes) -> bytes:
    """Return a message that is dropped only where it arrives: the side that waits goes on."""
    return data[:-1]


def shifted(message: type[Message], field: str, by_ns: int) -> Callable[[bytes], bytes]:
    """Return what moves a stamp in each `message` on the way, and mends its checksum."""

    def alter(data: bytes) -> bytes:
        schema = message.schema
        if len(data) != schema.size:
            return data
        content = bytearray(data)
        row = np.frombuffer(content, schema.dtype)
        if row[field][0]:
            row[field] += by_ns
        row["checksum"] = schema.compute_checksum(memoryview(content)[8:])
        return bytes(content)

    return alter


@pytest.mark.parametrize(
    ("side", "by_ns"),
    [("slave", -50_000_000), pytest.param("master", -HOUR_NS, marks=pytest.mark.slow)],
)
def test_a_clock_that_is_set_leads_through_holding_to_a_fresh_engagement(
    side: str, by_ns: int
) -> None:
    """The other side sees its stamps jump, and gives back what it saw."""
    with engaged(release_s=0.9, press_s=1.0) as session:
        if side == "slave":
            session.alter(
                shifted(Command, "echo_stamp_ns", -by_ns), shifted(SlaveState, "stamp_ns", by_ns)
            )
        else:
            session.alter(
                shifted(Command, "stamp_ns", by_ns), shifted(SlaveState, "echo_stamp_ns", -by_ns)
            )
        held = run(session, 0.3)
        other = [pair[0 if side == "slave" else 1] for pair in held]
        assert Reason.CLOCK_SET in {outline.reason for outline in other}
        assert all(state is State.HOLDING for pair in held[5:] for state, _ in pair)
        moved = session.slave._gated_position.copy()
        run(session, 0.05)
        np.testing.assert_array_equal(session.slave._gated_position, moved)
        waiting = run(session, 0.1)  # the switch is open by then
        assert all(state is not State.ENGAGED for pair in waiting for state, _ in pair)
        run(session, 0.3)
        assert states(session) == (State.ENGAGED, State.ENGAGED)


def test_a_link_that_was_cut_comes_back_into_holding() -> None:
    with engaged(release_s=1.2, press_s=1.3) as session:
        session.alter(lost, lost)
        run(session, 0.2)
        assert states(session) == (State.HOLDING, State.HOLDING)
        session.alter(None, None)
        motor = session.slave._gated_position.copy()
        after = run(session, 0.45)
        assert all(state is State.HOLDING for pair in after for state, _ in pair)
        np.testing.assert_array_equal(session.slave._gated_position, motor)
        run(session, 0.6)
        assert states(session) == (State.ENGAGED, State.ENGAGED)


def test_a_link_beyond_its_bound_is_scaled_then_held_then_a_fault_and_comes_back() -> None:
    """Half of the commands are lost: the slave finds it, and the master scales down."""
    chance = random.Random(1)  # noqa: S311 - a bad link, not a secret
    with engaged(release_s=4.2, press_s=5.6) as session:
        scale = float(session.master._settings.records["operator"]["position_scale"][0])
        force = float(session.master._settings.records["force"]["scale"][0])
        session.alter(lambda data: lost(data) if chance.random() < 0.5 else data, None)
        records, scales, down = session.master._settings.records, [], []
        for _ in range(150):
            down += run(session, 0.01)
            scales.append((records["operator"]["position_scale"][0], records["force"]["scale"][0]))
        told = [(slave.state, slave.reason) for _, slave in down]
        assert (State.ENGAGED, Reason.LINK_LOSS) in told
        assert told[-1] == (State.HOLDING, Reason.LINK_LOSS)
        least_scale, least_force = np.min(scales, axis=0)
        assert least_scale < 0.9 * scale
        assert least_force < 0.9 * force
        motor = session.slave._gated_position.copy()
        run(session, HOLD_LIMIT_S)
        assert session.slave._outline() == (State.FAULT, Reason.LINK_LOSS)
        np.testing.assert_array_equal(session.slave._gated_position, motor)
        session.alter(None, None)
        back = run(session, 1.1)
        assert all(slave.state is not State.ENGAGED for _, slave in back)
        run(session, 1.2)
        assert states(session) == (State.ENGAGED, State.ENGAGED)
        assert session.master._settings.records["force"]["scale"][0] == pytest.approx(force)
