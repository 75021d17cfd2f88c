"""What floods cost a side: bounded work, and no memory."""

import gc
import tracemalloc

import pytest

from studies import denial
from teleop.link.listener import VERIFY_BURST, Listener
from teleop.link.rate_limit import REFUSAL_KINDS_MAX, RateLimit, RefusalCounter
from teleop.messages.messages import EmergencyStop
from teleop.messages.topics import STOP, Role
from teleop.runtime.clock import now_ns
from teleop.security import CertificateRole, Identity
from teleop.security.keyring import ENTRY_BYTES, Keyring, TagVerdict
from teleop.security.presence import PairKeys, Peer
from tests.tick.memory_link import Sample

FLAT = 2_000_000  # [B]
MASTER = Peer(Role.MASTER, 1, Identity(CertificateRole.MASTER, "test"), bytes(32))
KEYS = PairKeys(bytes(32), b"\1" * 32)


def ring() -> Keyring:
    keyring = Keyring(Role.SLAVE, 2)
    keyring.add(MASTER, KEYS)
    return keyring


def growth_of(flood) -> int:
    """Memory [B] that is still there after a flood."""
    flood(1000)  # caches
    gc.collect()
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        flood(None)
        gc.collect()
        return tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("kind", ["mutated", "random senders"])
@pytest.mark.parametrize("count", [5_000, pytest.param(500_000, marks=pytest.mark.slow)])
def test_floods_are_counted_and_dropped_and_cost_no_memory(kind: str, count: int) -> None:
    """Of each of two topics so many frames; as `studies/denial.py`."""
    door = denial.Door()
    frames = denial.floods(door, min(count, 100_000))[kind]
    assert (door.accepted, door.dropped) == (2, 0)
    assert growth_of(lambda n: denial.flood(door, n or count, frames)) < FLAT
    assert (door.accepted, door.dropped) == (2, 2 * (count + 1000))
    assert denial.still_opens(door)


def test_a_flood_is_looked_at_no_more_than_the_limit_allows() -> None:
    keyring = ring()
    listener, looked = Listener(lambda *_: 1, keyring), []
    keyring.verify = lambda *_: looked.append(1) or TagVerdict.UNKNOWN  # type: ignore[method-assign]
    store = listener.store(STOP)
    data = EmergencyStop().pack(1, 1, 1)
    begin = now_ns()
    for _ in range(5 * VERIFY_BURST):
        store(Sample(data, bytes(ENTRY_BYTES)))
    allowed = VERIFY_BURST + (now_ns() - begin) * 1e-9 * 500 + 1
    assert VERIFY_BURST <= len(looked) <= allowed
    assert listener.refused(STOP) == 5 * VERIFY_BURST


def test_a_rate_limit_refills_with_time() -> None:
    now = [0]
    limit = RateLimit(2, 10.0, lambda: now[0])
    assert [limit() for _ in range(3)] == [True, True, False]
    now[0] = 100_000_000
    assert [limit() for _ in range(2)] == [True, False]
    now[0] = 10**12
    assert [limit() for _ in range(3)] == [True, True, False]
    now[0] = 0  # a clock that is set back gives nothing and takes nothing
    assert not limit()


def test_kinds_of_refusals_are_bounded() -> None:
    refusals = RefusalCounter()
    for n in range(1000):
        refusals.note(f"{n}")
    lines = refusals.take()
    assert len(lines) == REFUSAL_KINDS_MAX + 1
    assert lines[-1] == f"refused: {1000 - REFUSAL_KINDS_MAX} more"
    assert refusals.take() == []
