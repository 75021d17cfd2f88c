"""What floods cost a side: bounded work, and no memory.

A genuine command is mutated in 1 to 4 bytes or cut off, and so is a genuine emergency stop; as many
come from different senders. All must be counted and dropped.
"""

import gc
import random
import tracemalloc

import pytest

from teleop.link.listener import VERIFY_BURST, Listener
from teleop.link.rate_limit import REFUSAL_KINDS_MAX, RateLimit, RefusalCounter
from teleop.link.reception import LatestMessage
from teleop.messages.messages import Command, EmergencyStop
from teleop.messages.topics import COMMAND, STOP, Role
from teleop.runtime.clock import now_ns
from teleop.security import CertificateRole, Identity
from teleop.security.handshake import PairKeys, Peer
from teleop.security.keyring import ENTRY_BYTES, Keyring, TagVerdict
from tests.tick.memory_link import Sample

FLAT = 2_000_000  # [B]
MASTER = Peer(Role.MASTER, 1, Identity(CertificateRole.MASTER, "test"), bytes(32))
KEYS = PairKeys(bytes(32), b"\1" * 32)


def ring():
    keyring = Keyring(Role.SLAVE, 2)
    keyring.add(MASTER, KEYS)
    return keyring


class Door:
    """What receives at a slave: commands as the loop takes them, stops as Zenoh's thread does.

    Attributes
    ----------
    accepted : int
        Messages that were let in, which must be the genuine ones only.
    """

    def __init__(self):
        self.keyring = ring()
        senders = self.keyring.find_keys(COMMAND)
        self._latest = LatestMessage(
            COMMAND, lambda _: 1, senders=senders, addressee=self.keyring.addressee
        )
        self._listener = Listener(lambda *_: 1, self.keyring)
        self._store = self._listener.store(STOP)
        self.accepted = 0

    def tagged(self, topic, data):
        """Return a message of the master with its tag."""
        senders = self.keyring.find_keys(topic) or {}
        mac = senders[MASTER.nonce].copy()
        mac.update(data)
        return data + self.keyring.addressee + mac.digest()

    def command(self, frame):
        """Receive a command with its tags."""
        self._latest.take([(frame, now_ns())])
        self.accepted += self._latest.new

    def stop(self, frame):
        """Receive an emergency stop with its tags."""
        size = EmergencyStop.schema.size
        self._store(Sample(frame[:size], frame[size:]))
        self.accepted += len(self._listener.drain())

    @property
    def dropped(self):
        """Number of messages that were counted and not let in."""
        counts = self._latest.counts
        return counts.rejected + counts.unknown + self._listener.count_refused(STOP)


def mutated(frame, chance):
    """Yield frames that differ from `frame` in 1 to 4 bytes, every second one cut off too."""
    while True:
        new = bytearray(frame)
        for _ in range(chance.randint(1, 4)):
            new[chance.randrange(len(new))] ^= chance.randint(1, 255)
        del new[chance.choice((len(new), chance.randrange(len(new)))) :]
        if new != frame:  # two changes of one byte can undo each other
            yield bytes(new)


def of_random_senders(message, chance, senders):
    """Yield messages of different senders, with a checksum that is right, and a tag that is not."""
    names = [chance.getrandbits(64) for _ in range(senders)]
    while True:
        for name in names:
            yield message.pack(name, 1, now_ns()) + bytes(ENTRY_BYTES)


def flood(door, count, frames):
    """Send so many frames of each kind."""
    for topic, source in frames.items():
        receive = getattr(door, topic)
        for _ in range(count):
            receive(next(source))


def floods(door, senders):
    """Return the kinds of floods, by topic."""
    chance = random.Random(2)  # noqa: S311
    command = door.tagged(COMMAND, Command(state=1).pack(MASTER.nonce, 1, now_ns()))
    stop = door.tagged(STOP, EmergencyStop().pack(MASTER.nonce, 1, now_ns()))
    door.command(command)
    door.stop(stop)
    return {
        "mutated": {"command": mutated(command, chance), "stop": mutated(stop, chance)},
        "random senders": {
            "command": of_random_senders(Command(), chance, senders),
            "stop": of_random_senders(EmergencyStop(), chance, senders),
        },
    }


def still_opens(door):
    """Return whether a genuine command is let in after all that."""
    before = door.accepted
    door.command(door.tagged(COMMAND, Command(state=2).pack(MASTER.nonce, 2, now_ns())))
    return door.accepted == before + 1


def growth_of(flood):
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
def test_floods_are_counted_and_dropped_and_cost_no_memory(kind, count):
    """Of each of two topics so many frames."""
    door = Door()
    frames = floods(door, min(count, 100_000))[kind]
    assert (door.accepted, door.dropped) == (2, 0)
    assert growth_of(lambda n: flood(door, n or count, frames)) < FLAT
    assert (door.accepted, door.dropped) == (2, 2 * (count + 1000))
    assert still_opens(door)


def test_a_flood_is_looked_at_no_more_than_the_limit_allows():
    keyring = ring()
    listener, looked = Listener(lambda *_: 1, keyring), []
    keyring.verify = lambda *_: looked.append(1) or TagVerdict.UNKNOWN
    store = listener.store(STOP)
    data = EmergencyStop().pack(1, 1, 1)
    begin = now_ns()
    for _ in range(5 * VERIFY_BURST):
        store(Sample(data, bytes(ENTRY_BYTES)))
    allowed = VERIFY_BURST + (now_ns() - begin) * 1e-9 * 500 + 1
    assert VERIFY_BURST <= len(looked) <= allowed
    assert listener.count_refused(STOP) == 5 * VERIFY_BURST


def test_a_rate_limit_refills_with_time():
    now = [0]
    limit = RateLimit(2, 10.0, lambda: now[0])
    assert [limit() for _ in range(3)] == [True, True, False]
    now[0] = 100_000_000
    assert [limit() for _ in range(2)] == [True, False]
    now[0] = 10**12
    assert [limit() for _ in range(3)] == [True, True, False]
    now[0] = 0  # a clock that is set back gives nothing and takes nothing
    assert not limit()


def test_kinds_of_refusals_are_bounded():
    refusals = RefusalCounter()
    for n in range(1000):
        refusals.note(f"{n}")
    lines = refusals.take()
    assert len(lines) == REFUSAL_KINDS_MAX + 1
    assert lines[-1] == f"refused: {1000 - REFUSAL_KINDS_MAX} more"
    assert refusals.take() == []
