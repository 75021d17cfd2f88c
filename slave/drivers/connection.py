"""The slave's end of a driver's process: newest readings in, newest targets out, never waiting."""

import json
import select
import socket
import subprocess
import time
from collections.abc import Iterator

from slave.drivers import packets
from slave.drivers.driver import BusReading, Channels, Counts, DriverFault
from slave.drivers.driver_table import DriverConfig
from teleop.config.loading import as_tree
from teleop.runtime.child_process import start_module

START_S = 20.0  # [s] in which a bus must be set up
END_S = 2.0  # [s] in which it must be released


class DriverProcess:
    """A driver in a process of its own.

    Of its bus the `channels` are used; `DriverFault` if it cannot be opened or set up, or something
    is missing on it. `counts` are of the driver, every second and when it ends.
    """

    def __init__(self, config: DriverConfig, channels: Channels) -> None:
        self.counts: dict[str, int | float | str] = {}
        self._place = config.type
        self._end, other = packets.create_socket_pair()
        self._process = start_process(other, config, channels)
        other.close()
        try:
            self._await_ready()
        except DriverFault:
            self.close()
            raise

    def read(self) -> list[BusReading]:
        """Return the readings since the last call, oldest first; `DriverFault` if it failed."""
        readings = []
        while (packet := packets.receive_packet(self._end)) is not None:
            if packet[:1] == packets.READING:
                readings.append(packets.unpack_reading(packet))
            else:
                self._take(packet)
        return readings

    def write(self, target: Counts) -> None:
        """Send targets; the driver uses the newest."""
        self._send(packets.pack_target(target))

    def stop(self) -> None:
        """Stop the motors by their own means; the next target enables them again."""
        self._send(packets.STOP)

    def announce_pause(self) -> None:
        """Have the newest targets held, for up to `worker.PAUSE_TIMEOUT_S`, until the next come."""
        self._send(packets.PAUSE)

    def close(self) -> None:
        """Let the driver stop its motors and release the bus; never raises."""
        try:
            self._end.shutdown(socket.SHUT_WR)
            self._drain()
            self._process.wait(END_S)
        except (OSError, subprocess.TimeoutExpired):
            self._process.kill()
            self._process.wait()
        self._end.close()

    @property
    def pid(self) -> int:
        """Process id of the driver."""
        return self._process.pid

    def _await_packets(self, span_s: float) -> Iterator[bytes]:
        """Yield the packets that come within a time."""
        until_s = time.monotonic() + span_s
        while (left_s := until_s - time.monotonic()) > 0.0:
            select.select([self._end], [], [], left_s)
            packet = packets.receive_packet(self._end)
            if packet is not None:
                yield packet

    def _drain(self) -> None:
        """Read what the driver still sends, its counts, until it ends."""
        for packet in self._await_packets(END_S):
            if not packet:
                return
            if packet[:1] == packets.COUNTS:
                self.counts = json.loads(packet[1:])

    def _send(self, packet: bytes) -> None:
        try:
            self._end.send(packet)
        except BlockingIOError as error:  # the driver has not read for a hundred targets
            raise DriverFault(f"{self._place}: the driver's process hangs") from error
        except ConnectionError:
            self.read()  # its last packet says why
            raise DriverFault(f"{self._place}: the driver's process has ended") from None

    def _await_ready(self) -> None:
        for packet in self._await_packets(START_S):
            if packet == packets.READY:
                return
            self._take(packet)
        raise DriverFault(f"{self._place}: not ready within {START_S:g} s")

    def _take(self, packet: bytes) -> None:
        """Take a packet that is no reading; `DriverFault` if the driver has ended."""
        if packet[:1] == packets.COUNTS:
            self.counts = json.loads(packet[1:])
        elif packet[:1] == packets.FAULT:
            raise DriverFault(packet[1:].decode(errors="replace"))
        elif not packet:
            raise DriverFault(f"{self._place}: the driver's process has ended")


def start_process(
    end: socket.socket, config: DriverConfig, channels: Channels
) -> "subprocess.Popen[bytes]":
    """Start the process of a driver, which serves this end of a pair."""
    number, tree = end.fileno(), {"driver": as_tree(config), "channels": as_tree(channels)}
    return start_module(
        "slave.drivers.worker",
        *(str(number), json.dumps(tree)),
        gets_interrupts=True,
        pass_fds=[number],
    )
