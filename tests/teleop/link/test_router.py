"""Sessions behind routers: all meet there, nothing crosses over, nobody is there twice."""

import time
from contextlib import ExitStack, contextmanager

import pytest

from studies.testbed.processes import find_free_ports
from teleop.errors import PeerError, TeleopError
from teleop.link import Link, LinkConfig
from teleop.link.network import open_session
from teleop.link.router import Router
from teleop.messages.messages import Command, LoopReport
from teleop.messages.topics import COMMAND, REPORT, TOPICS, Role
from teleop.security import CertificateRole
from teleop.security.access import build_access_control
from teleop.security.credentials import create_local_credentials
from teleop.security.identity import ALL_SESSIONS
from tests.teleop.link.bench import oldest, pump, wait_until

SERVED = ("a", "b", "room-1", "room-1-left", "room-2")  # one is the beginning of another


def endpoints(count):
    return [f"127.0.0.1:{port}" for port in find_free_ports(count)]


@contextmanager
def routed():
    """A router, and the config of a link to it."""
    (end,) = endpoints(1)
    config = LinkConfig(routers=(end,))
    with Router(config, SERVED, [end], []):
        yield config


@contextmanager
def pair(config, name, other=None):
    """A slave and a master who know each other; the master may be at another router."""
    with (
        Link(config, name, Role.SLAVE) as slave,
        Link(other or config, name, Role.MASTER) as master,
    ):
        wait_until(lambda: slave.is_present(Role.MASTER) and master.is_present(Role.SLAVE))
        yield [slave, master]


def test_nothing_crosses_from_one_session_to_another():
    with routed() as config, ExitStack() as stack:
        names = SERVED[2:]
        pairs = {name: stack.enter_context(pair(config, name)) for name in names}
        ears = {}
        for name in names:
            ears[name] = stack.enter_context(Link(config, name, Role.RECORDER)).listen(TOPICS)
        for number, (slave, master) in enumerate(pairs.values()):
            pump(master, slave, number + 3)
            slave.publish(REPORT, LoopReport(role=Role.SLAVE))
        nonces = {name: {link.nonce for link in links} for name, links in pairs.items()}
        for name, ear in ears.items():
            slave, master = pairs[name]
            messages = []

            def heard_reports(ear=ear, messages=messages):
                messages.extend(ear.drain())
                return any(item.topic is REPORT for item in messages)

            wait_until(heard_reports)
            assert {item.sender for item in messages} <= nonces[name]
            for topic in TOPICS:
                counts = ear.count_messages(topic)
                assert counts.rejected + counts.unknown == 0
            for link in (slave, master):
                others = {token.nonce for token in link._roster.others if token.role in (1, 2)}
                assert others <= nonces[name]
                assert link.count_messages().rejected + link.count_messages().unknown == 0


@pytest.mark.usefixtures("true_settling")
def test_a_second_master_at_the_router_is_refused_and_the_first_stays():
    with routed() as config, pair(config, "a") as (slave, master):
        late = oldest(Link(config, "a", Role.MASTER))
        with pytest.raises(PeerError, match="'a' has a master already"), late:
            pass
        for link in (slave, master):
            link.check_peers()
        pump(master, slave)
        with Link(config, "b", Role.MASTER):  # another session
            pass


def test_two_sites_with_a_router_each_are_one_session():
    ends = endpoints(2)
    near, far = (LinkConfig(routers=(end,)) for end in ends)
    with (
        Router(near, SERVED, ends[:1], ends[1:]),  # its neighbour is not there yet
        Router(far, SERVED, ends[1:], []),
        pair(far, "a", near) as (slave, master),
    ):
        pump(master, slave, 3)


def test_a_router_that_is_started_again_brings_all_back():
    (end,) = endpoints(1)
    config = LinkConfig(routers=(end,))
    with ExitStack() as stack:
        first = Router(config, SERVED, [end], []).__enter__()
        slave, master = stack.enter_context(pair(config, "a"))
        pump(master, slave)
        first.__exit__()
        wait_until(lambda: not slave.is_present(Role.MASTER) and not master.is_present(Role.SLAVE))
        stack.enter_context(Router(config, SERVED, [end], []))
        wait_until(lambda: slave.is_present(Role.MASTER) and master.is_present(Role.SLAVE))
        pump(master, slave)
        assert slave.take_latest(COMMAND).counts.restarts == 0


def test_a_second_router_takes_over():
    ends = endpoints(2)
    config = LinkConfig(routers=tuple(ends))
    with Router(config, SERVED, ends[1:], []), ExitStack() as stack:
        first = Router(config, SERVED, ends[:1], ends[1:]).__enter__()
        slave, master = stack.enter_context(pair(config, "a"))
        pump(master, slave)
        first.__exit__()
        wait_until(lambda: slave.is_present(Role.MASTER) and master.is_present(Role.SLAVE))
        pump(master, slave)


def test_without_a_router_it_says_so_at_once():
    begin = time.monotonic()
    config = LinkConfig(routers=tuple(endpoints(2)))
    with pytest.raises(TeleopError, match=r"no router answers at .*, .*: teleop router"):
        Link(config, "a", Role.SLAVE).__enter__()
    assert time.monotonic() - begin < 5.0


def test_a_session_that_the_router_does_not_serve_stays_alone():
    (end,) = endpoints(1)
    config = LinkConfig(routers=(end,))
    with (
        Router(config, ("other",), [end], []),
        Link(config, "a", Role.SLAVE) as slave,
        Link(config, "a", Role.MASTER) as master,
    ):
        time.sleep(0.5)
        assert not slave.is_present(Role.MASTER)
        assert not master.is_present(Role.SLAVE)


@pytest.mark.parametrize("served", [("a",), (ALL_SESSIONS,)])
def test_what_a_role_must_not_send_ends_at_the_router(served):
    """Of a router of all sessions it gets through, and the slave does not believe it."""
    (end,) = endpoints(1)
    config = LinkConfig(routers=(end,))
    with (
        Router(config, served, [end], []),
        pair(config, "a") as (slave, master),
        open_session(
            create_local_credentials("a", CertificateRole.VIEWER),
            [],
            [end],
            build_access_control(["a"]),
            "client",
        ) as viewer,
    ):
        pump(master, slave)
        time.sleep(0.3)  # for commands that are still on their way
        before = slave.take_latest(COMMAND).counts
        received = before.received
        rejected = before.rejected + before.unknown
        for number in range(100):
            forged = Command(state=2).pack(master.nonce, 10_000 + number, 1)
            viewer.put("teleop/a/command", forged)
        time.sleep(0.3)
        after = slave.take_latest(COMMAND).counts
        assert after.received == received
        assert (after.rejected + after.unknown > rejected) == (served == (ALL_SESSIONS,))
        pump(master, slave, 3)
