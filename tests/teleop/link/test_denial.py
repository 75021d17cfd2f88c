"""What floods cost a side: bounded work, and no memory."""

import gc
import random
import tracemalloc

import pytest

from teleop.clock import now_ns
from teleop.keys import Identity, Office
from teleop.link.handshake import PairKeys, Peer
from teleop.link.keyring import ENTRY_BYTES, KEPT, Keyring, Verdict
from teleop.link.listener import LOOKS, Listener
from teleop.link.rate_limit import RateLimit
from teleop.link.reception import Latest
from teleop.link.refusals import KINDS, Refusals
from teleop.messages import Command, EmergencyStop
from teleop.topics import COMMAND, STOP, Role
from tests.tick.memory_link import Sample

FLAT = 2_000_000  # [B]
MASTER = Peer(Role.MASTER, 1, Identity(Office.MASTER, "test"), bytes(32))
KEYS = PairKeys(bytes(32), b"\1" * 32)


def ring() -> Keyring:
    keyring = Keyring(Role.SLAVE, 2)
    keyring.add(MASTER, KEYS)
    return keyring


def latest_of(keyring: Keyring) -> Latest[Command]:
    senders = keyring.senders(COMMAND)
    return Latest(COMMAND, lambda _: 1, senders=senders, addressee=keyring.addressee)


def tagged(keyring: Keyring, data: bytes) -> bytes:
    mac = keyring.senders(COMMAND)[1].copy()
    mac.update(data)
    return data + keyring.addressee + mac.digest()


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


@pytest.mark.parametrize("count", [2_000, pytest.param(100_000, marks=pytest.mark.slow)])
def test_random_senders_cost_no_memory(count: int) -> None:
    keyring, chance = ring(), random.Random(1)  # noqa: S311
    latest, listener = latest_of(keyring), Listener(lambda *_: 1, keyring)
    store = listener.store(STOP)

    def flood(n) -> None:
        for _ in range(n or count):
            sender = chance.getrandbits(64)
            latest.take([(Command().pack(sender, 1, 1) + bytes(ENTRY_BYTES), now_ns())])
            store(Sample(EmergencyStop().pack(sender, 1, 1), bytes(ENTRY_BYTES)))
            assert not listener.drain()

    assert growth_of(flood) < FLAT
    assert latest.counts.unknown == count + 1000
    assert listener.refused(STOP) == count + 1000
    latest.take([(tagged(keyring, Command().pack(1, 1, now_ns())), now_ns())])
    assert latest.new


@pytest.mark.parametrize("count", [3_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
def test_mutated_frames_are_counted_and_dropped(count: int) -> None:
    keyring, chance = ring(), random.Random(2)  # noqa: S311
    latest = latest_of(keyring)
    genuine = tagged(keyring, Command(state=1).pack(1, 1, now_ns()))
    latest.take([(genuine, now_ns())])

    def flood(n) -> None:
        for _ in range(n or count):
            frame = bytearray(genuine)
            for _ in range(chance.randint(1, 4)):
                frame[chance.randrange(len(frame))] ^= chance.randint(1, 255)
            del frame[chance.choice((len(frame), chance.randrange(len(frame)))) :]
            latest.take([(bytes(frame), now_ns())])
            assert not latest.new

    assert growth_of(flood) < FLAT
    counts = latest.counts
    assert counts.received == 1
    assert counts.rejected + counts.unknown == count + 1000
    latest.take([(tagged(keyring, Command(state=2).pack(1, 2, now_ns())), now_ns())])
    assert latest.new


def test_a_flood_is_looked_at_no_more_than_the_limit_allows() -> None:
    keyring = ring()
    listener, looked = Listener(lambda *_: 1, keyring), []
    keyring.verify = lambda *_: looked.append(1) or Verdict.UNKNOWN  # type: ignore[method-assign]
    store = listener.store(STOP)
    data = EmergencyStop().pack(1, 1, 1)
    begin = now_ns()
    for _ in range(5 * LOOKS):
        store(Sample(data, bytes(ENTRY_BYTES)))
    allowed = LOOKS + (now_ns() - begin) * 1e-9 * 500 + 1
    assert LOOKS <= len(looked) <= allowed
    assert listener.refused(STOP) == 5 * LOOKS


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


def test_peers_and_refusals_are_bounded() -> None:
    keyring, refusals = ring(), Refusals()
    for n in range(10, 10 + 3 * KEPT):
        keyring.add(MASTER._replace(nonce=n), KEYS)
        refusals.note(f"{n}")
    assert len(keyring.senders(COMMAND)) == KEPT
    lines = refusals.take()
    assert len(lines) == KINDS + 1
    assert lines[-1] == f"refused: {3 * KEPT - KINDS} more"
    assert refusals.take() == []
