"""The process of a driver, without a bus: what it does with a slave that hangs or is killed."""

import os
import subprocess
import sys
import time

import numpy as np
import pytest

from slave.drivers import packets, worker
from slave.drivers.worker import ParentProcess

STOP = "stop"


class Motors:
    """A driver of one motor that remembers what it was given, `STOP` for an emergency stop."""

    period_s = 0.001

    def __init__(self):
        self.targets, self.closed_s = [], None

    def start(self):
        pass

    def run_cycle(self, target):
        self.targets.append(target)
        assert len(self.targets) < 3000, "it was never stopped"
        return ()

    def stop(self):
        self.targets.append(STOP)

    def summarise(self):
        return {}

    def close(self):
        self.closed_s = time.monotonic()


TARGET = packets.pack_target(np.array([5.0]))


@pytest.mark.parametrize(
    ("sent", "silent_s"),
    [
        ([TARGET], 0.05),
        ([TARGET, packets.PAUSE, TARGET], 0.05),
    ],
)
def test_motors_of_a_slave_that_hangs_are_stopped_with_a_reason(monkeypatch, sent, silent_s):
    monkeypatch.setattr(worker, "TARGET_TIMEOUT_S", 0.05)
    monkeypatch.setattr(worker, "PAUSE_TIMEOUT_S", 0.15)
    motors = Motors()
    ours, theirs = packets.create_socket_pair()
    with ours, theirs:
        for packet in sent:
            ours.send(packet)
        worker.serve_driver(
            motors, theirs, ParentProcess(os.getpid())
        )  # it would run until `ours` is closed
        assert motors.targets[-1] == [5.0]
        assert motors.closed_s is not None
        told = []
        while (packet := packets.receive_packet(ours)) is not None:
            told.append(packet)
    assert told[-1][:1] == packets.FAULT
    assert told[-1].decode().endswith(f"the slave has given no target for {silent_s:g} s")


class Suspended(Motors):
    """The machine is suspended in its tenth cycle."""

    def __init__(self, suspend):
        super().__init__()
        self.suspend = suspend

    def run_cycle(self, target):
        if len(self.targets) == 9:
            self.suspend()
        return super().run_cycle(target)


def test_motors_get_no_old_target_after_a_suspension(monkeypatch):
    read = time.clock_gettime_ns
    motors = Suspended(
        lambda: monkeypatch.setattr(time, "clock_gettime_ns", lambda one: read(one) + 10**9)
    )
    ours, theirs = packets.create_socket_pair()
    with ours, theirs:
        ours.send(TARGET)
        worker.serve_driver(motors, theirs, ParentProcess(os.getpid()))
        *_, told = iter(lambda: packets.receive_packet(ours), None)
    assert len(motors.targets) == 10
    assert motors.closed_s is not None
    assert b"the machine was suspended for 1.0 s" in told


def test_a_slave_that_stops_its_motors_and_ends_at_once_has_stopped_them():
    motors = Motors()
    ours, theirs = packets.create_socket_pair()
    ours.send(packets.pack_target(np.array([5.0])))
    ours.send(packets.STOP)
    ours.close()
    with theirs:
        worker.serve_driver(motors, theirs, ParentProcess(os.getpid()))
    assert motors.targets == [STOP, None]  # a cycle repeats what a servo may have missed
    assert motors.closed_s is not None


def test_no_target_overtakes_an_emergency_stop():
    ours, theirs = packets.create_socket_pair()
    with ours, theirs:
        ours.send(packets.STOP)
        ours.send(packets.pack_target(np.array([5.0])))
        assert packets.receive_orders(theirs).stop


@pytest.fixture
def large():
    """A process of 200 MB, which take a while to be released; its end of a socket, and ours."""
    ours, theirs = packets.create_socket_pair()
    code = "import time; held = b'x' * 200_000_000; print(flush=True); time.sleep(100)"
    process = subprocess.Popen(
        [sys.executable, "-c", code], pass_fds=[theirs.fileno()], stdout=subprocess.PIPE
    )
    theirs.close()
    process.stdout.readline()
    with ours, process:
        yield process, ours
        process.kill()


def test_the_end_of_a_killed_process_is_seen_before_its_files_are_closed(large):
    process, ours = large
    parent = ParentProcess(process.pid)
    assert not parent.is_ending()
    process.kill()
    seen = closed = False
    while not closed:
        # looked at first: both may have come in between
        closed = packets.receive_packet(ours) == b""
        seen = seen or parent.is_ending()
    assert seen
    process.wait()
    assert parent.is_ending()


def test_motors_of_a_slave_that_ends_are_stopped_while_its_socket_is_still_open(large):
    process, _ = large
    process.kill()
    motors = Motors()
    ours, theirs = packets.create_socket_pair()
    with ours, theirs:
        worker.serve_driver(motors, theirs, ParentProcess(process.pid))
    assert motors.closed_s is not None


@pytest.mark.parametrize(
    ("now_s", "due_s"),
    [(10.0, 11.0), (10.9, 11.0), (11.2, 11.0), (12.2, 12.0), (19.7, 19.0)],
)
def test_a_cycle_that_is_late_is_followed_at_once_and_none_is_made_up_for(now_s, due_s):
    assert worker.compute_next_due(10.0, now_s, 1.0) == due_s
