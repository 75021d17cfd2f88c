"""What tests of the link share: links on free ports, and messages across them."""

import itertools
import os
import resource
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any

from studies.testbed.processes import find_free_ports
from teleop.link import LatestMessage, Link, LinkConfig
from teleop.link.network import open_session
from teleop.link.rate_limit import RefusalCounter
from teleop.messages.messages import LAYOUT, Command
from teleop.messages.topics import COMMAND, Role
from teleop.security import CertificateRole
from teleop.security.credentials import create_local_credentials
from teleop.security.handshake import Handshake
from teleop.security.keyring import Keyring
from teleop.security.presence import EXCLUSIVE_ROLES, LISTENER_ROLES, RoleStage, Token
from tests.rogue import Rogue

MS = 1_000_000


def free_config(**changes: Any) -> LinkConfig:
    """A link on two loopback ports that nobody has."""
    master, slave = (f"127.0.0.1:{port}" for port in find_free_ports(2))
    return LinkConfig(**{"master": master, "slave": slave} | changes)


def wait_until(condition: Callable[[], bool], seconds: float = 30.0) -> None:
    """Wait for a condition, on a busy machine too."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.002)


def await_refusals(refusals: RefusalCounter, *texts: str) -> None:
    """Wait until lines with all of these texts were said."""
    lines: list[str] = []

    def said() -> bool:
        lines.extend(refusals.take())
        return all(any(text in line for line in lines) for text in texts)

    wait_until(said)


@contextmanager
def session(config: LinkConfig, *roles: Role) -> Iterator[list[Link]]:
    """Links of these roles, opened in this order, all of them knowing each other."""
    with ExitStack() as stack:
        links = [stack.enter_context(Link(config, "test", role)) for role in roles]
        for one, two in itertools.permutations(links, 2):
            if (
                one.role in EXCLUSIVE_ROLES or two.role in EXCLUSIVE_ROLES
            ) and two.role not in LISTENER_ROLES:
                wait_until(lambda one=one, two=two: one.is_present(two.role))
        time.sleep(0.05)
        yield links


def pump(sender: Link, receiver: Link, count: int = 1) -> LatestMessage[Command]:
    """Publish commands until the receiver has let in `count` more."""
    latest = receiver.take_latest(COMMAND)
    goal = latest.counts.received + count

    def heard() -> bool:
        sender.publish(COMMAND, Command(state=1))
        return receiver.take_latest(COMMAND).counts.received >= goal

    wait_until(heard)
    return latest


def rogue_of(
    config: LinkConfig, role: CertificateRole = CertificateRole.ROUTER, count: int = 2
) -> Rogue:
    """A rogue with this certificate, connected to `count` links, that hears what is sent."""
    tls = create_local_credentials("test", role).build_tls_settings()
    rogue = Rogue([config.slave, config.master], "test", tls)
    for topic in ("command", "state"):
        rogue.listen(topic)
    wait_until(lambda: rogue.connected(count))
    time.sleep(0.2)
    return rogue


def open_as(role: CertificateRole, config: LinkConfig) -> Any:
    """Open a session of plain Zenoh with the slave, by a certificate of this user."""
    return open_session(create_local_credentials("test", role), [], [config.slave])


@contextmanager
def no_descriptor_left() -> Iterator[None]:
    """Take all descriptors that this process may have."""
    limit, taken = resource.getrlimit(resource.RLIMIT_NOFILE), []
    highest = max(map(int, os.listdir("/dev/fd")))
    resource.setrlimit(resource.RLIMIT_NOFILE, (highest + 3, limit[1]))
    try:
        with suppress(OSError):
            while True:
                taken.append(os.dup(0))
        yield
    finally:
        for number in taken:
            os.close(number)
        resource.setrlimit(resource.RLIMIT_NOFILE, limit)


def oldest(link: Link) -> Link:
    """A link, not open yet, as if its clock were far behind, so that it looks the oldest."""
    assert link.credentials is not None
    link.nonce = 1
    link._token = Token(link.role, LAYOUT, 1, RoleStage.CLAIM)
    link._handshake = Handshake(link.credentials, link.session, 1)
    link._keyring = Keyring(link.role, 1)
    return link


def packed(sequence: int, sender: int = 7, stamp_ns: int = 0) -> bytes:
    return Command().pack(sender, sequence, stamp_ns)
