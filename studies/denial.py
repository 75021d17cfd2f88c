"""What a flood costs a side: mutated frames and random senders at the door, and a viewer's tables.

python studies/denial.py [--count 1000000] [--senders 100000] [--seconds 10]

A genuine command is mutated `--count` times, in 1 to 4 bytes or cut off, and so is a genuine
emergency stop; as many come from `--senders` different senders. All must be counted and dropped,
and the memory of the process must stay within 2 MB. The time of a frame contains making it.

Then a viewer declares tokens of 30 kB, and subscribers, for `--seconds` each at a slave that is
connected with a master, each in a process of its own, and connects again whenever it is cut off. It
must have been connected, and have made at least 20 declarations. When it has left, both processes
must be alive, and the resident memory of the slave within 10 MB of what it was before.
"""

import argparse
import gc
import itertools
import random
import select
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from types import SimpleNamespace
from typing import Any, NamedTuple

import zenoh

from studies.testbed.processes import free_ports, resident_mb
from teleop.link.listener import Listener
from teleop.link.network import open_session
from teleop.link.reception import LatestMessage
from teleop.messages.messages import Command, EmergencyStop
from teleop.messages.topics import COMMAND, STOP, Role, Topic
from teleop.runtime.clock import now_ns
from teleop.security import CertificateRole, Identity
from teleop.security.credentials import create_local_credentials
from teleop.security.keyring import ENTRY_BYTES, Keyring
from teleop.security.presence import PairKeys, Peer

FLAT_MB = 2.0
WARM = 20_000  # frames before memory is measured, which fill caches
LEFT_MB = 10.0  # of a slave, after a viewer has left that declared what it could
DECLARED_MIN = 20  # by a viewer while it was connected, or there was no flood
START_S = 30.0  # of a slave and a master
LEAVING_S = 5.0
LONG = "x" * 30_000  # of a key
SIDE = """
import sys, time
from teleop.link import Link, LinkConfig
from teleop.messages.topics import Role
role, other = (Role[name] for name in sys.argv[3:])
with Link(LinkConfig(master=sys.argv[1], slave=sys.argv[2]), "denial", role) as link:
    while not link.present(other):
        time.sleep(0.01)
    print("ready", flush=True)
    while True:
        time.sleep(0.5)
        for line in link.refusals.take():
            print(line, file=sys.stderr, flush=True)
"""
MASTER = Peer(Role.MASTER, 1, Identity(CertificateRole.MASTER, "test"), bytes(32))
KEYS = PairKeys(bytes(32), b"\1" * 32)


class Payload(bytes):
    """A payload of Zenoh."""

    to_bytes = bytes.__bytes__


class Door:
    """What receives at a slave: commands as the loop takes them, stops as Zenoh's thread does.

    Attributes
    ----------
    accepted : int
        Messages that were let in, which must be the genuine ones only.
    """

    def __init__(self) -> None:
        self.keyring = Keyring(Role.SLAVE, 2)
        self.keyring.add(MASTER, KEYS)
        senders = self.keyring.senders(COMMAND)
        self._latest = LatestMessage(
            COMMAND, lambda _: 1, senders=senders, addressee=self.keyring.addressee
        )
        self._listener = Listener(lambda *_: 1, self.keyring)
        self._store: Callable[[Any], None] = self._listener.store(STOP)
        self.accepted = 0

    def tagged(self, topic: Topic[Any], data: bytes) -> bytes:
        """Return a message of the master with its tag."""
        senders = self.keyring.senders(topic) or {}
        mac = senders[MASTER.nonce].copy()
        mac.update(data)
        return data + self.keyring.addressee + mac.digest()

    def command(self, frame: bytes) -> None:
        """Receive a command with its tags."""
        self._latest.take([(frame, now_ns())])
        self.accepted += self._latest.new

    def stop(self, frame: bytes) -> None:
        """Receive an emergency stop with its tags."""
        size = EmergencyStop.schema.size
        payload, tags = Payload(frame[:size]), Payload(frame[size:])
        self._store(SimpleNamespace(payload=payload, attachment=tags))
        self.accepted += len(self._listener.drain())

    @property
    def dropped(self) -> int:
        """Number of messages that were counted and not let in."""
        counts = self._latest.counts
        return counts.rejected + counts.unknown + self._listener.refused(STOP)


def mutated(frame: bytes, chance: random.Random) -> Iterator[bytes]:
    """Yield frames that differ from `frame` in 1 to 4 bytes, every second one cut off too."""
    while True:
        new = bytearray(frame)
        for _ in range(chance.randint(1, 4)):
            new[chance.randrange(len(new))] ^= chance.randint(1, 255)
        del new[chance.choice((len(new), chance.randrange(len(new)))) :]
        if new != frame:  # two changes of one byte can undo each other
            yield bytes(new)


def of_random_senders(
    message: Command | EmergencyStop, chance: random.Random, senders: int
) -> Iterator[bytes]:
    """Yield messages of different senders, with a checksum that is right, and a tag that is not."""
    names = [chance.getrandbits(64) for _ in range(senders)]
    while True:
        for name in names:
            yield message.pack(name, 1, now_ns()) + bytes(ENTRY_BYTES)


def flood(door: Door, count: int, frames: dict[str, Iterator[bytes]]) -> None:
    """Send so many frames of each kind."""
    for topic, source in frames.items():
        receive = getattr(door, topic)
        for _ in range(count):
            receive(next(source))


def floods(door: Door, senders: int) -> dict[str, dict[str, Iterator[bytes]]]:
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


def still_opens(door: Door) -> bool:
    """Return whether a genuine command is let in after all that."""
    before = door.accepted
    door.command(door.tagged(COMMAND, Command(state=2).pack(MASTER.nonce, 2, now_ns())))
    return door.accepted == before + 1


def declare_token(session: zenoh.Session, number: int) -> Any:
    key = f"teleop/denial/@/viewer/{number:08x}/{number:016x}/held/{LONG}"
    return session.liveliness().declare_token(key)


def declare_subscriber(session: zenoh.Session, number: int) -> Any:
    return session.declare_subscriber(f"teleop/denial/{number}", zenoh.handlers.DefaultHandler())


class TableFlood(NamedTuple):
    """A slave before, in and after a flood of a viewer."""

    before_mb: float  # memory of the slave
    largest_mb: float
    after_mb: float
    connections: int  # of the viewer
    declared: int  # by it, as long as it was connected
    ended: dict[str, int | None]  # side -> exit code, None = is alive

    def failures(self) -> list[str]:
        """Return what is wrong, one line each."""
        lines = [
            f"the {side} has ended with {code}"
            for side, code in self.ended.items()
            if code is not None
        ]
        if not self.connections:
            lines.append("the viewer was never connected")
        if self.declared < DECLARED_MIN:
            lines.append(f"the viewer declared {self.declared}, at least {DECLARED_MIN} are needed")
        if self.after_mb - self.before_mb > LEFT_MB:
            lines.append(f"the slave keeps more than {LEFT_MB:g} MB")
        return lines


def flood_tables(declare: Callable[[zenoh.Session, int], Any], seconds: float) -> TableFlood:
    """Flood the tables of a slave, which is connected with a master, as a viewer."""
    ends = [f"127.0.0.1:{port}" for port in free_ports(2)]
    viewer = create_local_credentials("denial", CertificateRole.VIEWER)
    connections = declared = 0
    with ExitStack() as stack:
        sides: dict[str, subprocess.Popen[bytes]] = {}
        for role, other in (("SLAVE", "MASTER"), ("MASTER", "SLAVE")):
            words = [sys.executable, "-c", SIDE, *ends, role, other]
            side = stack.enter_context(subprocess.Popen(words, stdout=subprocess.PIPE))
            stack.callback(side.kill)
            sides[role.lower()] = side
        for side in sides.values():
            if side.stdout is None or not select.select([side.stdout], [], [], START_S)[0]:
                raise SystemExit("slave and master do not meet")
            side.stdout.readline()
        time.sleep(1.0)
        slave = sides["slave"].pid
        memory = [resident_mb(slave)]
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            # once cut off, it may neither declare nor close in time
            with suppress(zenoh.ZError), open_session(viewer, [], [ends[1]]) as session:
                kept = []
                while not session.info.peers_zid() and time.monotonic() < end:
                    time.sleep(0.01)
                connections += bool(session.info.peers_zid())
                for number in itertools.count():
                    if number % 10 == 0:
                        memory.append(resident_mb(slave))
                        if not session.info.peers_zid() or time.monotonic() > end:
                            break
                        declared = declared + 10 * (number > 0)
                    kept.append(declare(session, number))
        time.sleep(LEAVING_S)
        after_mb = resident_mb(slave)  # 0 of one that has ended
        ended = {role: side.poll() for role, side in sides.items()}
    return TableFlood(memory[0], max(memory), after_mb, connections, declared, ended)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1_000_000, help="mutated frames of a topic")
    parser.add_argument("--senders", type=int, default=100_000, help="random senders of a topic")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each flood of a viewer")
    args = parser.parse_args()
    door = Door()
    kinds = floods(door, args.senders)
    failed = False
    for name, frames in kinds.items():
        count = args.count if name == "mutated" else args.senders
        flood(door, WARM, frames)
        gc.collect()
        memory, dropped, accepted = resident_mb(), door.dropped, door.accepted
        begin = time.perf_counter()
        flood(door, count, frames)
        seconds = time.perf_counter() - begin
        gc.collect()
        grown = resident_mb() - memory
        sent = count * len(frames)
        failed |= door.dropped - dropped != sent or door.accepted != accepted or grown > FLAT_MB
        print(
            f"{name:15} {sent} frames: {door.dropped - dropped} dropped, "
            f"{door.accepted - accepted} accepted, {seconds / sent * 1e6:.1f} us each, "
            f"memory {grown:+.2f} MB"
        )
    failed |= not still_opens(door)
    for declare in (declare_token, declare_subscriber):
        tables = flood_tables(declare, args.seconds)
        failed |= bool(tables.failures())
        print(
            f"{declare.__name__:18} {tables.declared} in {tables.connections} connections: memory "
            f"of a slave {tables.before_mb:.1f} MB, at most {tables.largest_mb:.1f} MB, "
            f"{tables.after_mb:.1f} MB when the viewer has left"
        )
        print("".join(f"FAILED: {line}\n" for line in tables.failures()), end="")
    print("FAILED" if failed else "a genuine command is still accepted")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
