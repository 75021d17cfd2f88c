"""A bus belongs to one process: the next one is refused, and told who has it."""

import array
import fcntl
import os
import subprocess
import sys
import termios

import pytest

from slave.drivers.claim import claim_bus
from slave.drivers.driver import DriverFault
from slave.drivers.serial_port import open_serial

TIOCGEXCL = 0x80045440  # of the kernel: whether a terminal is in exclusive mode
HOLD = (
    "import sys; from slave.drivers.claim import claim_bus; "
    "held = claim_bus('CAN', sys.argv[1]); print(flush=True); sys.stdin.read()"
)


@pytest.fixture
def key():
    return f"test {os.getpid()}"


@pytest.fixture
def port():
    far, near = os.openpty()
    yield os.ttyname(near), near
    os.close(far)
    os.close(near)


def test_a_bus_is_refused_with_the_holder_until_that_has_ended(key):
    command = [sys.executable, "-c", HOLD, key]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        holder.stdout.readline()
        for _ in range(3):  # asking does not use up the answer
            with pytest.raises(DriverFault, match=rf"^CAN 7: in use by process {holder.pid} \("):
                claim_bus("CAN 7", key)
        holder.kill()
        holder.wait()
    claim_bus("CAN 7", key).close()


def test_the_program_is_named_in_place_of_the_process_of_its_driver(key):
    command = [sys.executable, "-c", HOLD, key, "slave.drivers.worker"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        holder.stdout.readline()
        with pytest.raises(DriverFault, match=f"in use by process {os.getpid()} "):
            claim_bus("CAN 7", key)
        holder.kill()


def test_a_serial_port_is_one_by_whatever_name(port, tmp_path):
    name, _ = port
    link = tmp_path / "by-id"
    link.symlink_to(name)
    opened, claim = open_serial(name, 115200)
    with claim, opened, pytest.raises(DriverFault, match="by-id: in use by process"):
        open_serial(str(link), 115200)
    again, claim = open_serial(str(link), 115200)
    with claim, again:
        pass


def test_other_programs_are_kept_off_a_serial_port_and_keep_us_off(port):
    name, near = port
    opened, claim = open_serial(name, 115200)
    with claim, opened:
        exclusive = array.array("i", [0])
        fcntl.ioctl(near, TIOCGEXCL, exclusive)
        assert exclusive[0]
    fcntl.ioctl(near, termios.TIOCNXCL)  # the last close does, of a real port
    fcntl.flock(near, fcntl.LOCK_EX)
    with pytest.raises(DriverFault, match="cannot be opened: in use by another program"):
        open_serial(name, 115200)
    fcntl.flock(near, fcntl.LOCK_UN)
    opened, claim = open_serial(name, 115200)  # what was refused holds nothing
    with claim, opened:
        pass
