"""What a tick costs in numbers that do not depend on the machine: calls, bytes, memory.

`teleop bench loop` measures what it costs in time. A limit that is reached here is a step back in
latency on every machine (docs/explanation/coupling.md); one that can be lowered should be.
"""

import gc
import sys
import tracemalloc
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial

import numpy as np
import pytest

from teleop.messages.topics import COMMAND, HAND, LATENCY, LINK, REPORT, STATE, TENDONS, TOPICS
from teleop.session.state_machine import State
from tests.tick.session import Session

SETTLED = 600  # ticks, until both sides are engaged, all is compiled and a report has been made
COUNTED = 100  # ticks
REPORTED = 500  # ticks between two reports, when the meters begin new spans

# 'call' events of a tick, entries into compiled code among them; 'c_call' events
# of Python's 16 are the scripted hand's, 3 a call of rig or device those that tell a slow one, 2
# the watch for a suspension; of C's 4 are the tag of a message, 5 another's check
MASTER_PYTHON, MASTER_C = 64, 51
SLAVE_PYTHON, SLAVE_C = 34, 31
WIRE = {COMMAND: 324, STATE: 576, TENDONS: 1460, HAND: 260}  # [B]
HELD = 50_000  # [B] at once, within a tick of both sides; most of it in one with a report
KEPT = 10_000, 150  # [B], blocks: from one report to the next; a leak of 20 B a tick would be more


@pytest.fixture(scope="module")
def session() -> Iterator[Session]:
    with ExitStack() as stack:
        session = Session(stack)
        for _ in range(SETTLED):
            session.tick()
        yield session


@pytest.fixture(scope="module")
def counted(session: Session) -> Session:
    session.counting = True
    for _ in range(COUNTED):
        session.tick()
    session.counting = False
    return session


def test_what_is_counted_is_a_session_that_renders_forces(session: Session) -> None:
    master, slave = session.master.summarise(), session.slave.summarise()
    for side in (master, slave):
        assert side.final_state is State.ENGAGED
        assert side.faults == ()
        assert side.lost == side.unknown == side.overruns == 0
    assert master.ticks == slave.ticks
    assert master.latency_ms.n >= SETTLED - 1  # each command was answered in its own tick
    assert slave.rig is not None
    assert slave.rig.rig["coarse_reads"] == 0


def test_the_master_calls_no_more_from_its_tick_to_the_device(counted: Session) -> None:
    python, c = counted.master_calls.per_span()
    assert counted.master_calls.spans == COUNTED
    assert python <= MASTER_PYTHON, counted.master_calls.table()
    assert c <= MASTER_C, counted.master_calls.c
    assert counted.master_calls.python["VirtualDevice.write"] == COUNTED  # counted to the end


def test_the_slave_calls_no_more_from_the_command_to_its_state(counted: Session) -> None:
    python, c = counted.slave_calls.per_span()
    assert counted.slave_calls.spans == COUNTED
    assert python <= SLAVE_PYTHON, counted.slave_calls.table()
    assert c <= SLAVE_C, counted.slave_calls.c
    assert counted.slave_calls.ended == COUNTED  # the state was put on the wire


def test_the_reports_of_a_side_are_published_in_ticks_of_their_own(session: Session) -> None:
    """All at once took so long that the tick behind them was skipped, twice a second."""
    places = [TOPICS.index(topic) for topic in (REPORT, LATENCY, LINK)]
    numbers = []
    for _ in range(REPORTED + 50):
        session.tick()
        sent = session.master._link.list_last_sequences()
        numbers.append([sent[place] for place in places])
    published = np.diff(numbers, axis=0)
    assert published.sum(axis=0).min() >= 1
    assert published.sum(axis=1).max() == 1


def test_what_can_be_undone_leaves_the_monitors_which_are_not_copied(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monitors, seen = session.slave._slave.memory["monitors"], set()

    def compare(call, *arguments):
        seen.add(before := monitors.tobytes())
        result = call(*arguments)
        assert monitors.tobytes() == before
        return result

    for name in ("_step_slave", "_estimate_ahead"):
        monkeypatch.setattr(session.slave, name, partial(compare, getattr(session.slave, name)))
    for _ in range(20):
        session.tick()
    assert len(seen) >= 20  # they change after each tick


def test_live_messages_are_as_long_as_they_were(session: Session) -> None:
    for topic, size in WIRE.items():
        assert session.sizes[topic.name] == topic.message.schema.size <= size, topic.name


def test_a_tick_holds_little_memory_and_gives_it_back(session: Session) -> None:
    tracemalloc.start()
    try:
        windows = [_window(session) for _ in range(3)]
    finally:
        tracemalloc.stop()
    # what was allocated before counts as new when it is replaced, so the first windows show more
    assert max(held for held, _, _ in windows) <= HELD
    assert min(kept for _, kept, _ in windows) <= KEPT[0]
    assert min(blocks for _, _, blocks in windows) <= KEPT[1]


def _window(session: Session) -> tuple[int, int, int]:
    """Tick from one report to the next; return bytes held at once, bytes and blocks kept."""
    gc.collect()  # cycles that wait for it are not kept
    kept, blocks, held = tracemalloc.get_traced_memory()[0], sys.getallocatedblocks(), 0
    for _ in range(REPORTED):
        tracemalloc.reset_peak()
        before = tracemalloc.get_traced_memory()[0]
        session.tick()
        held = max(held, tracemalloc.get_traced_memory()[1] - before)
    gc.collect()
    kept = tracemalloc.get_traced_memory()[0] - kept
    return held, kept, sys.getallocatedblocks() - blocks
