"""A peer in a process of its own, which is killed or frozen."""

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

from teleop.link import Link
from teleop.link.network import LEASE_MS
from teleop.messages.messages import Event, SlaveState, TendonState
from teleop.messages.topics import COMMAND, EVENT, STATE, TENDONS, Role
from teleop.runtime.clock import now_ns
from tests.root import ROOT
from tests.teleop.link.bench import MS, wait_until

PEER = """
import sys, time
from teleop.runtime.process import die_with_parent
die_with_parent(int(sys.argv[3]))
from teleop.link import Link, LinkConfig
from teleop.messages.messages import Command
from teleop.messages.topics import COMMAND, EVENT, STATE, Role
with Link(LinkConfig(master=sys.argv[1], slave=sys.argv[2]), "test", Role.MASTER) as link:
    link.subscribe_latest(STATE)
    listener = link.listen((EVENT,))
    while True:
        link.publish(COMMAND, Command())
        time.sleep(0.001)
"""

VIEWER = """
import sys, time
from teleop.runtime.process import die_with_parent
die_with_parent(int(sys.argv[3]))
from teleop.link import Link, LinkConfig
from teleop.messages.topics import TOPICS, Role
with Link(LinkConfig(master=sys.argv[1], slave=sys.argv[2]), "test", Role.VIEWER) as link:
    listener = link.listen(TOPICS)
    while True:
        listener.drain()
        time.sleep(0.02)
"""


@contextmanager
def other_process(config, code=PEER):
    """A master, or other code, in a process of its own."""
    process = subprocess.Popen(
        [sys.executable, "-c", code, config.master, config.slave, str(os.getpid())], cwd=ROOT
    )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGCONT)
        process.kill()
        process.wait()


def test_a_killed_peer_is_gone_and_its_successor_welcome(config):
    with Link(config, "test", Role.SLAVE) as slave:
        slave.subscribe_latest(COMMAND)
        with other_process(config) as first:
            wait_until(lambda: slave.take_latest(COMMAND).counts.received > 20)
            first.send_signal(signal.SIGKILL)
            wait_until(lambda: not slave.is_present(Role.MASTER), seconds=1.0)
        with other_process(config):
            wait_until(lambda: slave.take_latest(COMMAND).counts.restarts == 1)
            wait_until(lambda: slave.is_present(Role.MASTER))


def test_a_frozen_peer_grows_old_and_is_fresh_again_when_it_thaws(config):
    with Link(config, "test", Role.SLAVE) as slave:
        slave.subscribe_latest(COMMAND)
        with other_process(config) as master:
            wait_until(lambda: slave.take_latest(COMMAND).counts.received > 100)
            master.send_signal(signal.SIGSTOP)
            wait_until(lambda: slave.take_latest(COMMAND).compute_age_ns(now_ns()) > 300 * MS)
            assert slave.is_present(Role.MASTER)
            master.send_signal(signal.SIGCONT)
            wait_until(lambda: slave.take_latest(COMMAND).is_fresh(now_ns(), 20 * MS))


def test_publishing_to_a_frozen_peer_goes_on(config):
    with Link(config, "test", Role.SLAVE) as slave, other_process(config) as master:
        wait_until(lambda: slave.take_latest(COMMAND).counts.received > 0)
        time.sleep(0.1)  # for its subscriptions to be known here
        master.send_signal(signal.SIGSTOP)
        longest = 0.0
        for _ in range(10_000):  # far more than all buffers on the way hold
            for topic, message in ((STATE, SlaveState()), (EVENT, Event())):
                began = time.monotonic()
                slave.publish(topic, message)
                longest = max(longest, time.monotonic() - began)
        assert longest < 1.0  # one that waits for room does so for 5 s


def test_a_viewer_that_stops_reading_does_not_delay_commands(config):
    """Bytes are left to send when its connection, silent for a lease, is closed."""
    with Link(config, "test", Role.SLAVE) as slave, other_process(config):
        latest = slave.subscribe_latest(COMMAND)
        wait_until(lambda: slave.take_latest(COMMAND).counts.received > 0)
        with other_process(config, VIEWER) as viewer:
            wait_until(lambda: not slave.skip_unsubscribed(TENDONS))
            time.sleep(1.0)  # its connections carry messages
            viewer.send_signal(signal.SIGSTOP)
            begin = fresh = now_ns()
            longest = left = 0
            while now_ns() - begin < (LEASE_MS + 1500) * MS:
                if left < 500:  # more than the viewer's buffer holds, less than ours does
                    left += 1
                    slave.publish(TENDONS, TendonState())
                time.sleep(0.001)
                if slave.take_latest(COMMAND).new:
                    fresh = now_ns()
                longest = max(longest, now_ns() - fresh)
            assert slave.skip_unsubscribed(TENDONS)
        assert latest.counts.received > 1000
        assert longest < 500 * MS  # SO_LINGER was ten seconds
