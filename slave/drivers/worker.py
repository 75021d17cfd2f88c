"""The process of one driver: cycles of its bus, and packets to and from the slave.

It is a process and not a thread: compiled code of the slave holds the interpreter's lock for as
long as it runs, seconds in the analysis of a calibration, and the motors' watchdogs would end.

  python -m slave.drivers.worker FD CONFIG     started by slave.drivers.connection
"""

import contextlib
import math
import os
import signal
import socket
import sys
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from slave.drivers import packets
from slave.drivers.driver import BusDriver, BusReading, Channels, Counts, DriverFault
from slave.drivers.driver_table import DriverConfig, open_driver
from teleop.config.loading import ConfigDocument
from teleop.errors import TeleopError
from teleop.runtime.clock import SuspensionWatch, pause_garbage_collection

# --- the end of the slave's process, seen before the kernel has released its memory

_EXITING = 0x4  # PF_EXITING of the kernel, in the field "flags" of proc_pid_stat(5)
_FLAGS_FIELD = 6  # place of that field, counted from the one behind the command's name
_STAT_SIZE_MAX = 1024  # [B] of the file


class ParentProcess:
    """The process that has started this one.

    The kernel releases the memory of a killed process before it closes its files: the end of the
    file at the other end of a socket comes 45 ms late with 300 MB, 110 ms late if they are locked.
    That the process is ending is told by its flags at once. A system without `/proc` has the end
    of the file only.
    """

    def __init__(self, process: int) -> None:
        self._file: int | None = None
        with contextlib.suppress(FileNotFoundError):
            self._file = os.open(f"/proc/{process}/stat", os.O_RDONLY | os.O_CLOEXEC)

    def is_ending(self) -> bool:
        """Return whether the process is known to have ended, or to be about to."""
        if self._file is None:
            return False
        try:
            text = os.pread(self._file, _STAT_SIZE_MAX, 0)
        except ProcessLookupError:
            return True
        return bool(int(text.rpartition(b")")[2].split()[_FLAGS_FIELD]) & _EXITING)


COUNTS_S = 1.0  # [s] between two packets of counts
TARGET_TIMEOUT_S = 0.2  # [s] without a target while motors are enabled: the slave hangs
PAUSE_TIMEOUT_S = 30.0  # [s] the same, if the slave has announced a pause
QUEUE_LENGTH = 64  # readings that wait for a slave that does not read; the oldest are dropped


@dataclass(frozen=True)
class WorkerConfig:
    """What a driver's process is started with."""

    driver: DriverConfig
    channels: Channels


def main(words: Sequence[str]) -> int:
    """Serve the driver described by the words of the command; return the exit code."""
    number, text = words
    for ending in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # the slave ends this process
        signal.signal(ending, signal.SIG_IGN)
    slave = ParentProcess(os.getppid())
    end = socket.socket(fileno=int(number))
    try:
        config = ConfigDocument(text=text).load(WorkerConfig)
        opened = open_driver(config.driver, config.channels)
        with pause_garbage_collection():  # a collection takes longer than a cycle
            serve_driver(opened, end, slave)
    except (DriverFault, TeleopError) as error:
        _send_packet(end, packets.pack_fault(str(error)))
        return 1
    finally:
        end.close()
    return 0


def serve_driver(driver: BusDriver, end: socket.socket, slave: ParentProcess) -> None:
    """Run a driver until the slave or its end of the socket is gone, or the driver fails.

    A fault is sent as the last packet; the motors are then stopped already.
    """
    fault = ""
    try:
        driver.start()
        _send_packet(end, packets.READY)
        _run_cycles(driver, end, slave)
    except DriverFault as error:
        fault = str(error)
    except Exception as error:
        fault = f"the driver failed: {type(error).__name__}: {error}"
    finally:
        driver.close()
        with contextlib.suppress(OSError):
            end.send(packets.pack_counts(driver.summarise()))
        if fault:
            _send_packet(end, packets.pack_fault(fault))


def _run_cycles(driver: BusDriver, end: socket.socket, slave: ParentProcess) -> None:
    target: Counts | None = None
    ordered_s, silent_s = 0.0, TARGET_TIMEOUT_S  # when the target came, and how long it counts
    waiting: deque[BusReading] = deque(maxlen=QUEUE_LENGTH)
    due_s = counts_s = time.monotonic()
    suspension = SuspensionWatch()
    while True:
        if explanation := suspension.explain():  # before an old target is sent again
            raise DriverFault(explanation)
        orders = packets.receive_orders(end)
        if orders.stop:  # before the end of the slave, and before a target that came with it
            target = None
            driver.stop()
        elif orders.ended or (orders.target is None and slave.is_ending()):
            return
        elif orders.target is not None:
            target, ordered_s, silent_s = orders.target, time.monotonic(), TARGET_TIMEOUT_S
        if orders.pause:
            silent_s = PAUSE_TIMEOUT_S
        if target is not None and time.monotonic() - ordered_s > silent_s:
            raise DriverFault(f"the slave has given no target for {silent_s:g} s")
        waiting.extend(driver.run_cycle(target))
        with contextlib.suppress(BlockingIOError, ConnectionError):
            while waiting:
                end.send(packets.pack_reading(waiting[0]))
                waiting.popleft()
            if time.monotonic() >= counts_s:
                counts_s = time.monotonic() + COUNTS_S
                end.send(packets.pack_counts(driver.summarise()))
        if driver.period_s:
            now = time.monotonic()
            due_s = compute_next_due(due_s, now, driver.period_s)
            time.sleep(max(0.0, due_s - now))


def compute_next_due(due_s: float, now_s: float, period_s: float) -> float:
    """Return when the next cycle is due, on an absolute grid.

    A cycle that took a little longer than its period is followed at once by the next one; of those
    that are missed altogether only the last is due.
    """
    next_s = due_s + period_s
    return next_s + period_s * max(0, math.floor((now_s - next_s) / period_s))


def _send_packet(end: socket.socket, packet: bytes) -> None:
    """Send a packet that matters: the slave reads, or is gone."""
    with contextlib.suppress(OSError):
        end.settimeout(1.0)
        end.send(packet)
        end.setblocking(False)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
