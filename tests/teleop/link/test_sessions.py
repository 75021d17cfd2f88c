"""Links to each other, on loopback."""

import os
import socket
import time

import pytest

from teleop.errors import PeerError, UsageError
from teleop.link import Link, MessageCounts, network
from teleop.link.config import Address
from teleop.link.network import BATCH_BYTES
from teleop.messages.messages import Command, Event, Hand, LoopReport, SlaveState, encode_text
from teleop.messages.topics import COMMAND, EVENT, HAND, REPORT, STATE, TOPICS, Role
from tests.teleop.link.bench import MS, free_config, pump, session, wait_until


def test_messages_cross_whole_and_in_order(config):
    with session(config, Role.SLAVE, Role.MASTER, Role.RECORDER) as (slave, master, recorder):
        for link, topic in ((slave, COMMAND), (master, STATE)):
            link.subscribe_latest(topic)
        listener = recorder.listen(TOPICS)
        time.sleep(0.1)
        sent = []
        for k in range(50):
            stamp = master.publish(COMMAND, Command(state=k, position=(k * 0.5,) * 8))
            slave.publish(STATE, SlaveState(joints=k, echo_stamp_ns=stamp))
            sent.append(stamp)
            time.sleep(0.002)
        slave.publish(EVENT, Event(role=Role.SLAVE, text=encode_text("ready")))
        master.publish(REPORT, LoopReport(role=Role.MASTER))
        slave.publish(REPORT, LoopReport(role=Role.SLAVE))

        wait_until(lambda: slave.take_latest(COMMAND).counts.received > 0)
        wait_until(lambda: master.take_latest(STATE).counts.received > 0)
        command, state = slave.take_latest(COMMAND).message, master.take_latest(STATE).message
        assert command is not None
        assert state is not None
        assert command.sender == master.nonce
        assert command.stamp_ns == sent[command.sequence - 1]
        assert command.state == command.sequence - 1
        assert command.position == (command.state * 0.5,) * 8
        assert state.echo_stamp_ns == sent[state.joints]

        heard = []
        wait_until(
            lambda: heard.extend(listener.drain()) or listener.count_messages(REPORT).received == 2
        )
        assert {h.sender for h in heard if h.topic == REPORT} == {master.nonce, slave.nonce}
        commands = [h for h in heard if h.topic == COMMAND]
        assert len(commands) > 25
        assert [h.sequence for h in commands] == sorted({h.sequence for h in commands})
        for h in commands:
            assert Command.unpack(h.data).state == h.sequence - 1
            assert h.stamp_ns == sent[h.sequence - 1]
            assert h.sender == master.nonce
            assert h.received_ns >= h.stamp_ns - MS
        counts = listener.count_messages(COMMAND)
        first, last = commands[0].sequence, commands[-1].sequence
        assert counts == MessageCounts(
            received=len(commands), lost=last - first + 1 - len(commands)
        )


def test_sessions_on_the_same_endpoints_do_not_hear_each_other(config):
    with Link(config, "one", Role.SLAVE) as slave, Link(config, "two", Role.MASTER) as master:
        slave.subscribe_latest(COMMAND)
        for _ in range(50):
            master.publish(COMMAND, Command())
            time.sleep(0.002)
        assert slave.take_latest(COMMAND).message is None
        assert not slave.is_present(Role.MASTER)
        assert not master.is_present(Role.SLAVE)


def test_without_a_peer_publishing_is_quiet_and_the_peer_is_found_when_it_comes(config):
    with Link(config, "test", Role.MASTER) as master:
        for _ in range(100):
            master.publish(COMMAND, Command())
        assert not master.is_present(Role.SLAVE)
        master.check_peers()
        with Link(config, "test", Role.SLAVE) as slave:
            wait_until(lambda: master.is_present(Role.SLAVE))
            pump(master, slave)
        wait_until(lambda: not master.is_present(Role.SLAVE))
        for _ in range(100):
            master.publish(COMMAND, Command())
        with Link(config, "test", Role.SLAVE) as slave:
            pump(master, slave)


def test_a_viewer_gets_copies_of_fast_topics_and_calls_the_rest_not_lost(config):
    """At 500 Hz: 100 a second; nobody but the viewer listens, so the rest is not composed."""
    with (
        session(config, Role.SLAVE, Role.MASTER) as (_, master),
        Link(config, "test", Role.VIEWER) as viewer,
    ):
        listener = viewer.listen([HAND, COMMAND], sampled={HAND})
        wait_until(lambda: not master.skip_unsubscribed(COMMAND))
        wait_until(lambda: not master.skip_unsubscribed(HAND))
        begin, composed = time.monotonic(), 0
        for _ in range(200):
            if not master.skip_unsubscribed(HAND):
                master.publish(HAND, Hand())
                composed += 1
            master.publish(COMMAND, Command())
            time.sleep(0.002)
        passed_s = time.monotonic() - begin

        def received(topic):
            listener.drain()
            return listener.count_messages(topic).received

        wait_until(lambda: received(COMMAND) == 200)  # not sampled
        wait_until(lambda: received(HAND) == composed)
        assert 20 <= composed <= 100.0 * passed_s + 2
        assert listener.count_messages(HAND).lost == 0
        assert listener.count_messages(HAND).overwritten >= 200 - composed - 10


def test_copies_come_at_their_rate_though_all_messages_are_sent(config):
    with (
        session(config, Role.SLAVE, Role.MASTER) as (_, master),
        Link(config, "test", Role.VIEWER) as viewer,
    ):
        copies, everything = viewer.listen([COMMAND], sampled={COMMAND}), viewer.listen([COMMAND])

        def received(listener):
            listener.drain()
            return listener.count_messages(COMMAND).received

        def both_hear():
            master.publish(COMMAND, Command())
            return min(received(copies), received(everything)) > 0

        wait_until(both_hear)
        before, begin = (received(copies), received(everything)), time.monotonic()
        for _ in range(200):
            master.publish(COMMAND, Command())
            time.sleep(0.002)
        passed_s = time.monotonic() - begin
        wait_until(lambda: received(everything) - before[1] >= 200)
        assert 10 <= received(copies) - before[0] <= 50.0 * passed_s + 2


def test_connections_leave_no_file_open(config):
    """Each connection looks through the open files for its own."""
    with Link(config, "test", Role.SLAVE) as slave, open("/dev/null", "rb"):

        def connected_and_gone():
            with Link(config, "test", Role.VIEWER) as viewer:
                viewer.listen((STATE,))
                wait_until(lambda: slave.has_listener(STATE))
            wait_until(lambda: not slave.has_listener(STATE))
            time.sleep(0.1)
            return len(os.listdir("/dev/fd"))

        before = connected_and_gone()
        after = [connected_and_gone() for _ in range(4)]
        assert after[-1] <= before + 2, (before, after)


def test_a_topic_subscribed_to_twice_has_one_inbox_that_is_emptied(config):
    """A second inbox that nobody reads kept every command: 2 MB a second at the slave."""
    with session(config, Role.SLAVE, Role.MASTER) as (slave, master):
        first = slave.subscribe_latest(COMMAND)
        assert slave.subscribe_latest(COMMAND) is first
        assert len(slave._subscribers) == 1
        message = pump(master, slave).message
        assert first.message is message is not None


def test_a_port_of_someone_else_is_named_with_a_remedy(config, monkeypatch):
    monkeypatch.setattr(network, "OPEN_MS", 300)  # that its silence is waited for
    with socket.socket() as other:
        other.bind(("127.0.0.1", Address.parse(config.slave).port))
        other.listen()
        with pytest.raises(UsageError) as caught, Link(config, "test", Role.SLAVE):
            pass
    assert not isinstance(caught.value, PeerError)
    assert config.slave in str(caught.value)
    assert "another process uses this port" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_address_of_another_machine_is_named_with_a_remedy():
    config = free_config(slave="192.0.2.1:7448", insecure=True)
    with (
        pytest.raises(UsageError, match=r"192\.0\.2\.1:7448.*not an address of this machine"),
        Link(config, "test", Role.SLAVE),
    ):
        pass


def test_a_role_publishes_only_its_own_topics(config):
    with Link(config, "test", Role.SLAVE) as slave:
        with pytest.raises(ValueError, match="hand is published by"):
            slave.publish(HAND, HAND.message())
        with pytest.raises(ValueError, match="several publishers"):
            slave.subscribe_latest(EVENT)


def test_every_message_fits_into_one_batch_with_room_for_its_key():
    assert max(topic.message.schema.size for topic in TOPICS) + 256 <= BATCH_BYTES
