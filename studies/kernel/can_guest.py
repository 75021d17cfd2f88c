"""The CAN checks, run as the first process of a virtual machine: our driver on SocketCAN.

The driver is the project's own, in its own process; the drives are `studies/rigs/models/drives.py`
in another, on the CANopen stack durand. Between them is the kernel's own CAN, on a virtual
interface.

An emulated processor takes 1.6 s to start Python with the libraries of either. So the drives serve
all checks, as on a bench, and the driver's process is a fork of this one, which has imported what
it needs; only the first one is started as the slave does it.
"""

import fcntl
import json
import os
import signal
import socket
import struct
import subprocess
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from slave.drivers import connection, driver_table, worker
from slave.drivers.cia402 import driver  # noqa: F401 - so that forks have it
from slave.drivers.cia402.config import BusConfig, Cia402Config
from slave.drivers.connection import DriverProcess
from slave.drivers.driver import Channels, DriverFault
from studies.kernel.init import run_checks, try_check
from studies.kernel.judge import WrongError
from studies.rigs.bench import BUS, Model
from teleop.config.loading import as_tree

# --- virtual CAN interfaces of the kernel, and error frames on them, without the program `ip`

_NEW_LINK, _REQUEST, _ACK, _CREATE, _EXCLUSIVE = 16, 1, 4, 0x400, 0x200
_NAME, _LINK_INFO, _KIND = 3, 18, 1  # attributes
_SET_FLAGS, _UP = 0x8914, 1
_ERROR_FRAME, _BUS_OFF = 1 << 29, 0x40


def create_interface(name: str) -> None:
    """Create a virtual CAN interface and set it up; `OSError`."""
    kind = _pack_attribute(_LINK_INFO, _pack_attribute(_KIND, b"vcan\0"))
    body = (
        struct.pack("=BxHiII", 0, 0, 0, 0, 0) + _pack_attribute(_NAME, name.encode() + b"\0") + kind
    )
    flags = _REQUEST | _ACK | _CREATE | _EXCLUSIVE
    with socket.socket(socket.AF_NETLINK, socket.SOCK_RAW, socket.NETLINK_ROUTE) as link:
        link.send(struct.pack("=IHHII", 16 + len(body), _NEW_LINK, flags, 1, 0) + body)
        (error,) = struct.unpack_from("=i", link.recv(4096), 16)
    if error:
        raise OSError(-error, f"interface {name}")
    switch_interface(name, up=True)


def switch_interface(name: str, up: bool) -> None:
    """Set an interface up or down; `OSError`."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as can:
        fcntl.ioctl(can, _SET_FLAGS, struct.pack("16sH14x", name.encode(), _UP if up else 0))


def send_bus_off(name: str) -> None:
    """Send the frame by which a controller says that it is off the bus."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as can:
        can.bind((name,))
        can.send(struct.pack("=IB3x8x", _ERROR_FRAME | _BUS_OFF, 8))


def _pack_attribute(number: int, value: bytes) -> bytes:
    padding = bytes(-len(value) % 4)
    return struct.pack("=HH", 4 + len(value), number) + value + padding


CHANNEL = "vcan0"
RATE_HZ = 50.0  # of an emulated processor
RATE_MIN = 0.9
DRIVES = 4
STOP_MAX_S = 0.050
WAIT_S = 10.0
STILL_S = 0.3
FOLLOW_S = 2.0
STEP = 50.0  # [counts]

Figures = dict[str, str]


def main() -> None:
    """Never returns."""
    here = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    os.environ |= {"PYTHONPATH": here, BUS: f"socketcan,{CHANNEL}"}
    run_checks(_try_all)


def _try_all(say: Callable[..., None]) -> None:
    create_interface(CHANNEL)
    left = list(CHECKS)
    while left:  # after a failure with drives that know nothing of it
        with Model("cia402", DRIVES, "springs", realtime=False) as model:
            bench = Bench(model)
            while left and try_check(say, f"can, {DRIVES} drives", left.pop(0), bench):
                connection.start_process = Fork


class Fork:
    """The process of a driver, as `start_process` starts one, without the start of Python."""

    def __init__(
        self, end: socket.socket, config: driver_table.DriverConfig, channels: Channels
    ) -> None:
        number = end.fileno()
        self.pid = os.fork()
        if self.pid == 0:
            os.closerange(3, number)
            os.closerange(number + 1, os.sysconf("SC_OPEN_MAX"))
            tree = {"driver": as_tree(config), "channels": as_tree(channels)}
            try:
                os._exit(worker.main([str(number), json.dumps(tree)]))
            finally:
                traceback.print_exc()
                os._exit(1)

    def wait(self, timeout_s: float = WAIT_S) -> None:
        """Wait until it has ended; `subprocess.TimeoutExpired`."""
        until_s = time.monotonic() + timeout_s
        while os.waitpid(self.pid, os.WNOHANG) == (0, 0):
            if time.monotonic() > until_s:
                raise subprocess.TimeoutExpired("fork", timeout_s)
            time.sleep(0.002)

    def kill(self) -> None:
        """End it."""
        os.kill(self.pid, signal.SIGKILL)


class Bench:
    """Drives on the interface, and our driver's process."""

    numbers = tuple(range(1, DRIVES + 1))

    def __init__(self, model: Model) -> None:
        self.model = model

    def build_config(self, error_control: str = "heartbeat") -> Cia402Config:
        bus = BusConfig(interface="socketcan", channel=CHANNEL)
        return Cia402Config(bus=bus, rate_hz=RATE_HZ, timeout=0.2, error_control=error_control)

    def open_driver(self, error_control: str = "heartbeat") -> DriverProcess:
        return DriverProcess(self.build_config(error_control), Channels(self.numbers, self.numbers))

    @contextmanager
    def drive(self, error_control: str = "heartbeat") -> Iterator[tuple]:
        """Open the drives and engage them; give the driver and the target [counts]."""
        connection = self.open_driver(error_control)
        try:
            yield connection, self.engage(connection)
        finally:
            connection.close()

    def read_position(self, connection: DriverProcess):
        """Return where the motors are [counts], as the driver says."""
        until_s = time.monotonic() + WAIT_S
        while time.monotonic() < until_s:
            if readings := connection.read():
                return readings[-1].position
            time.sleep(0.005)
        raise WrongError("no reading")

    def engage(self, connection: DriverProcess):
        """Write where the motors are until all follow; return the target [counts]."""
        target = self.read_position(connection)
        self.wait_until(connection, self.all_move, "the drives are not enabled", target)
        self.hold(connection, target, 0.1)  # until the driver knows it, too
        return target

    def hold(self, connection: DriverProcess, target, duration_s: float) -> int:
        """Write a target for a while; return how many readings came."""
        count, until_s = 0, time.monotonic() + duration_s
        while time.monotonic() < until_s:
            count += len(connection.read())
            connection.write(target)
            time.sleep(0.005)
        return count

    def wait_until(self, connection, condition, otherwise: str, target=None) -> None:
        until_s = time.monotonic() + WAIT_S
        while not condition():
            if time.monotonic() > until_s:
                raise WrongError(otherwise)
            if connection is not None:
                connection.read()
                if target is not None:
                    connection.write(target)
            time.sleep(0.005)

    def all_move(self) -> bool:
        return all(self.model.order()["moving"])

    def measure_stop(self, since_s: float) -> str:
        """Wait until no drive follows; return the time that took, which must be short."""
        self.wait_until(
            None, lambda: not any(self.model.order()["moving"]), "the drives do not stop"
        )
        took_s = self.model.order()["stopped_s"] - since_s
        if not 0.0 <= took_s <= STOP_MAX_S:
            raise WrongError(f"stopped only after {took_s * 1e3:.0f} ms")
        return f"{took_s * 1e3:.0f} ms"

    def await_fault(self, connection: DriverProcess, target, *words: str) -> str:
        """Write a target until the driver gives up; return its reason, with one of the words."""
        until_s = time.monotonic() + WAIT_S
        try:
            while time.monotonic() < until_s:
                connection.read()
                connection.write(target)
                time.sleep(0.002)
        except DriverFault as fault:
            if any(word in str(fault) for word in words):
                return str(fault)
            raise
        raise WrongError("no fault was told")

    def engage_anew(self) -> None:
        """Open it again: nothing moves by itself, then everything follows."""
        connection = self.open_driver()
        try:
            until_s = time.monotonic() + STILL_S
            while time.monotonic() < until_s:
                self.read_position(connection)
                if any(self.model.order()["moving"]):
                    raise WrongError("a drive moves by itself")
            self.engage(connection)
        finally:
            connection.close()


def follow(bench: Bench) -> Figures:
    """Drives follow from where they are; every reading comes."""
    with bench.drive() as (connection, start):
        goal = start + STEP
        bench.wait_until(
            connection,
            lambda: np.allclose(bench.read_position(connection), goal, atol=2.0),
            "the drives do not arrive",
            goal,
        )
        began_s = time.monotonic()
        rate_hz = bench.hold(connection, goal, FOLLOW_S) / (time.monotonic() - began_s)
    if rate_hz < RATE_MIN * RATE_HZ:
        raise WrongError(f"{rate_hz:.1f} Hz of {RATE_HZ:g}")
    lost = connection.counts["lost_cycles"]
    return {"readings": f"{rate_hz:.1f} Hz", "lost": str(lost)}


def emergency_stop(bench: Bench) -> Figures:
    """Quick stop, and enabled again by the next target."""
    with bench.drive() as (connection, target):
        began_s = time.monotonic()
        connection.stop()
        took = bench.measure_stop(began_s)
        bench.wait_until(connection, bench.all_move, "the drives are not enabled again", target)
    return {"stopped after": took}


def killed(bench: Bench, error_control: str = "heartbeat") -> Figures:
    """Kill the driver: the drives miss our heartbeat and stop."""
    with bench.drive(error_control) as (connection, _):
        killed_s = time.monotonic()
        os.kill(connection.pid, signal.SIGKILL)
        took = bench.measure_stop(killed_s)
    bench.engage_anew()
    return {"stopped after": took}


def killed_while_guarded(bench: Bench) -> Figures:
    """The same where the drives are guarded, by remote frames."""
    return killed(bench, "guarding")


def fault(bench: Bench) -> Figures:
    """A drive's fault is named, refused at the next start, and reset by the operator alone."""
    with bench.drive() as (connection, target):
        bench.model.order("fault")
        said = bench.await_fault(connection, target, "following error")
    try:
        bench.open_driver().close()
    except DriverFault as error:
        if "teleop rig reset" not in str(error):
            raise
    else:
        raise WrongError("a drive with a fault was not refused")
    lines = list(driver_table.reset(bench.build_config(), bench.numbers))
    bench.engage_anew()
    return {"fault": said, "reset": lines[0]}


def silent(bench: Bench) -> Figures:
    """Drives without power on the bus side are named."""
    try:
        with bench.drive() as (connection, target):
            bench.model.order("unplug")
            said = bench.await_fault(connection, target, "silent")
    finally:
        bench.model.order("plug")
    bench.engage_anew()
    return {"fault": said}


def bus_off(bench: Bench) -> Figures:
    """The controller's error frame is a fault with its reason."""
    with bench.drive() as (connection, target):
        send_bus_off(CHANNEL)
        said = bench.await_fault(connection, target, "bus off")
    bench.engage_anew()
    return {"fault": said}


def interface_down(bench: Bench) -> Figures:
    """An interface that is set down is a fault, and the drives stop by themselves."""
    try:
        with bench.drive() as (connection, target):
            began_s = time.monotonic()
            switch_interface(CHANNEL, up=False)
            said = bench.await_fault(connection, target, "interface is down", "silent")
            took = bench.measure_stop(began_s)
    finally:
        switch_interface(CHANNEL, up=True)
    return {"fault": said, "stopped after": took}


CHECKS = (
    follow,
    emergency_stop,
    killed,
    killed_while_guarded,
    fault,
    silent,
    bus_off,
    interface_down,
)
