"""The guard, with real processes: what it writes when the process it belongs to is killed."""

import os
import signal
import subprocess
import sys
import time

import pytest

from master.devices.hid import watchdog
from master.devices.hid.watchdog import ForceWatchdog
from studies.testbed.processes import wait_for_condition

OWNER = """
import sys, time
from master.devices.hid.watchdog import ForceWatchdog
owner = ForceWatchdog(sys.argv[1], [b"one", b"two"])
print("up", flush=True)
for _ in range(1000):
    owner.beat()
    time.sleep(0.05)
"""


@pytest.fixture
def owned(tmp_path):
    """A process that pushes, and the file that stands for the node."""
    node = tmp_path / "node"
    node.touch()
    owner = subprocess.Popen([sys.executable, "-c", OWNER, str(node)], stdout=subprocess.PIPE)
    with owner.stdout as said:
        assert said.readline() == b"up\n"
    yield owner, node
    owner.kill()
    owner.wait()


def test_a_killed_owner_leaves_a_silent_device(owned):
    owner, node = owned
    before = node.read_bytes()
    owner.kill()
    assert wait_for_condition(lambda: len(node.read_bytes()) > len(before), 5.0)
    assert node.read_bytes().endswith(b"onetwo")


def test_a_stopped_owner_leaves_a_silent_device_each_time(owned):
    owner, node = owned
    silenced = 0
    for _ in range(20):  # a busy machine may stop it between two silences of its own
        before = node.read_bytes()
        owner.send_signal(signal.SIGSTOP)
        silenced += wait_for_condition(lambda before=before: node.read_bytes() != before, 1.0)
        said = node.read_bytes()
        assert not wait_for_condition(
            lambda said=said: node.read_bytes() != said, 3 * watchdog.HEARTBEAT_TIMEOUT_S
        )
        if silenced == 2:
            break
        owner.send_signal(signal.SIGCONT)
        time.sleep(0.2)  # it beats again
    assert silenced == 2
    assert node.read_bytes().endswith(b"onetwo")


def test_before_the_first_beat_nothing_is_written(tmp_path):
    node = tmp_path / "node"
    node.touch()
    owner = ForceWatchdog(str(node), [b"zero"])
    assert not wait_for_condition(node.read_bytes, 2 * watchdog.HEARTBEAT_TIMEOUT_S)
    assert owner.end()


def test_one_report_that_fails_does_not_keep_the_others_back(tmp_path, monkeypatch):
    written = []

    def write(file, data):
        if data == b"bad":
            raise OSError
        written.append(data)

    monkeypatch.setattr(watchdog.os, "write", write)
    monkeypatch.setattr(watchdog.os, "read", lambda *_: b"")
    monkeypatch.setattr(watchdog.select, "select", lambda *_: ([0], [], []))
    watchdog.main(os.devnull, b"bad".hex(), b"good".hex())
    assert written == [b"ready\n", b"good"]
