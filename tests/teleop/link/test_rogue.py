"""A rogue peer beside a running pair: nothing it does is believed, and the pair goes on.

Its certificate is that of a router, which Zenoh's access control lets do everything: what refuses
it here is the handshake and the tags. With a viewer's certificate nothing of it arrives at all.
"""

import struct
import time

import pytest

from teleop.link import Link, connection_guard
from teleop.messages.messages import LAYOUT, Command, EmergencyStop, Setting, SlaveState
from teleop.messages.topics import COMMAND, SETTING, STATE, STOP, Role
from teleop.remote.request_listener import RESET, RequestListener
from teleop.security import CertificateRole
from teleop.security.credentials import create_local_credentials
from tests.rogue import ENGAGED, POSITION_AT, STATE_AT, Rogue, forged
from tests.teleop.link.bench import await_refusals, pump, rogue_of, session, wait_until

FAR = struct.pack("<8d", *(0.014,) * 8)  # [m] a position to pull the tip to
ENGAGE = ((STATE_AT, struct.pack("<I", ENGAGED)), (POSITION_AT, FAR))


@pytest.fixture
def pair(config):
    with session(config, Role.SLAVE, Role.MASTER) as (slave, master):
        master.subscribe_latest(STATE)
        slave.subscribe_latest(COMMAND)
        yield slave, master


def capture(rogue, master, slave):
    """Let the rogue hear a command and a state."""

    def heard():
        master.publish(COMMAND, Command(state=1))
        slave.publish(STATE, SlaveState(state=1))
        time.sleep(0.01)
        return all(rogue.heard.values())

    wait_until(heard)
    pump(master, slave)


def goes_on(slave, master):
    for link in (slave, master):
        link.check_peers()
    pump(master, slave, 3)
    assert slave.take_latest(COMMAND).message.sender == master.nonce
    assert slave.take_latest(COMMAND).message.state == 1


def test_forged_and_played_back_messages_move_nothing(pair, config):
    slave, master = pair
    with rogue_of(config) as rogue:
        capture(rogue, master, slave)
        command, tags = rogue.heard["command"][-1]
        state, _ = rogue.heard["state"][-1]
        for n in range(5):
            rogue.put("command", forged("Command", command, 10**9 + n, *ENGAGE))
            rogue.put("command", forged("Command", command, 10**12 + n, *ENGAGE), tags)
            rogue.put("command", command, tags)  # as it was heard
            rogue.put("state", forged("SlaveState", state, 10**9 + n, ENGAGE[0]), tags)

            def refused(count=n + 1):  # read at once: an inbox keeps 16 messages
                at_slave, at_master = (
                    slave.take_latest(COMMAND).counts,
                    master.take_latest(STATE).counts,
                )
                old = at_slave.repeated + at_slave.out_of_order
                found = at_slave.forged, at_slave.unknown, old, at_master.unknown
                return found == (count,) * 4

            wait_until(refused)
        goes_on(slave, master)
    assert slave.take_latest(COMMAND).counts.restarts == 0


def test_commands_of_an_earlier_run_mean_nothing_to_a_new_slave(config):
    with session(config, Role.SLAVE, Role.MASTER) as (slave, master):
        slave.subscribe_latest(COMMAND)
        with rogue_of(config) as rogue:
            capture(rogue, master, slave)
            wait_until(lambda: any("/@/master/" in key for key in rogue.tokens))
            old = rogue.heard["command"][-1], rogue.token_of("master")
    (command, tags), token = old
    with Link(config, "test", Role.SLAVE) as slave:
        slave.subscribe_latest(COMMAND)
        with rogue_of(config, count=1) as rogue:
            rogue.announce_key(token)  # genuine, but its process is gone
            for _ in range(5):
                rogue.put("command", command, tags)

            def counted():
                counts = slave.take_latest(COMMAND).counts
                return counts.forged + counts.unknown == 5

            wait_until(counted)
        with Link(config, "test", Role.MASTER) as master:
            pump(master, slave, 3)


def test_forged_tokens_are_refused_in_words_and_evict_nobody(pair, config):
    slave, master = pair
    with rogue_of(config) as rogue:
        wait_until(lambda: any("/@/master/" in key for key in rogue.tokens))
        proof = rogue.token_of("master").rsplit("/", 1)[1]
        for role in ("master", "slave", "remote"):
            rogue.announce(role, LAYOUT, 1)  # the oldest number, without a proof
            rogue.announce(role, LAYOUT, 2, proof="AAAA")
            rogue.announce(role, LAYOUT, 3, proof=proof)  # another process's
        rogue.announce("viewer", LAYOUT, master.nonce)
        lines = {"slave": [], "master": []}

        def told():
            lines["slave"] += slave.refusals.take()
            lines["master"] += master.refusals.take()
            return all(
                any(text in line for line in found)
                for found in lines.values()
                for text in ("a master without a certificate", "cannot be read", "does not hold")
            )

        wait_until(told)
        assert not slave.is_present(Role.REMOTE)
        goes_on(slave, master)


def test_stops_resets_and_settings_need_a_supervisor(pair, config):
    slave, master = pair
    requests = {link: RequestListener(link) for link in pair}
    time.sleep(0.2)
    with rogue_of(config) as rogue:
        for sender in (master.nonce, slave.nonce, 12345):
            for action in range(4):
                rogue.stop(LAYOUT, sender, action, side=int(Role.SLAVE))
            rogue.set(LAYOUT, sender, b"force.scale", b"9")

        def refused():
            for listen in requests.values():
                assert listen.take_requests(0) == ((0, "", False, ()))
            return all(listen.count_refused()["stop"] == 12 for listen in requests.values())

        wait_until(refused)
    with Link(config, "test", Role.REMOTE) as remote:
        wait_until(lambda: master.is_present(Role.REMOTE) and slave.is_present(Role.REMOTE))
        wait_until(lambda: remote.is_present(Role.MASTER) and remote.is_present(Role.SLAVE))
        remote.publish(SETTING, Setting())
        remote.publish(STOP, EmergencyStop(action=RESET, side=Role.SLAVE, number=0))
        wait_until(lambda: len(requests[master].take_requests(0).settings) == 1)
        wait_until(lambda: requests[slave].take_requests(0).reset)


def test_a_viewer_is_heard_by_nobody(pair, config):
    slave, master = pair
    requests = {link: RequestListener(link) for link in pair}
    with rogue_of(config, CertificateRole.VIEWER) as rogue:
        capture(rogue, master, slave)
        time.sleep(0.2)
        before = slave.take_latest(COMMAND).counts.received
        command, tags = rogue.heard["command"][-1]
        for n in range(20):
            rogue.put("command", forged("Command", command, 10**9 + n, *ENGAGE), tags)
            rogue.stop(LAYOUT, master.nonce, 0)
            rogue.announce("master", LAYOUT, n)
        rogue.announce("viewer", LAYOUT, 1)
        time.sleep(0.3)
        counts = slave.take_latest(COMMAND).counts
        assert (counts.received, counts.rejected, counts.unknown) == (before, 0, 0)
        assert all(listen.count_refused()["stop"] == 0 for listen in requests.values())
        assert {token.role for token in slave._roster.others} == {Role.MASTER}
        goes_on(slave, master)


@pytest.mark.parametrize(
    ("role", "group", "kept"),
    [(CertificateRole.VIEWER, "viewer", 0), (CertificateRole.SUPERVISOR, "remote", 100)],
)
def test_nothing_is_kept_of_a_listener_but_subscribers(role, group, kept, config, monkeypatch):
    """Zenoh removes tokens and queryables at once when a connection ends, and sends nothing."""
    monkeypatch.setattr(connection_guard, "NAME_BLOCK_S", 0.3)
    with Link(config, "test", Role.SLAVE) as slave:
        states = slave._zenoh.declare_publisher("teleop/test/state")
        tls = create_local_credentials("test", role).build_tls_settings()
        with Rogue([config.slave], "test", tls) as rogue:
            wait_until(rogue.connected)
            for n in range(100):
                rogue.announce(group, LAYOUT, n)
                rogue.answer(group, n)
            rogue.listen("state")  # behind all that
            wait_until(lambda: states.matching_status.matching)
            tokens = slave._zenoh.liveliness().get(f"teleop/test/@/{group}/**")
            assert len(list(tokens)) == kept
            asks = slave._zenoh.declare_querier(f"teleop/test/@/prove/{group}/{5:016x}")
            assert asks.matching_status.matching == bool(kept)


def test_a_lost_number_is_not_taken_by_somebody_else(pair, config):
    """A second process with the number of the master, and a certificate of a master."""
    slave, master = pair
    twin = Link(config, "test", Role.MASTER)
    twin._token = twin._handshake.prove(
        master._token.__class__(Role.MASTER, LAYOUT, master.nonce, master._token.stage)
    )
    with rogue_of(config) as rogue:
        rogue.announce_key(twin._token.to_key("test"))
        await_refusals(slave.refusals, "takes the number")
        goes_on(slave, master)
