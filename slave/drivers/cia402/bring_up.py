"""What `teleop rig` does with CANopen nodes: read, scan, reset."""

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack

import can
import numpy as np

from slave.drivers.cia402.bus import format_bus_name, open_network, to_driver_fault
from slave.drivers.cia402.config import Cia402Config
from slave.drivers.cia402.drive import DriveState, NoAnswer, NodeSetup
from slave.drivers.cia402.monitor import BusMonitor
from slave.drivers.driver import BusReading, Channels, Counts, DriverFault

# --- CANopen nodes that are only read: every frame is an SDO upload

RATE_HZ = 50.0  # at most; an upload takes two frames a value


class Cia402Reader:
    """A `slave.drivers.driver.BusDriver` that writes nothing and takes no targets."""

    def __init__(self, config: Cia402Config, channels: Channels) -> None:
        self._config, self._channels = config, channels
        self.period_s = 1.0 / min(RATE_HZ, config.rate_hz)
        self._stack = ExitStack()
        self._nodes: dict[int, NodeSetup] = {}
        self._monitor = BusMonitor(config.bus)

    def start(self) -> None:
        """Open the bus; look at the state of every drive."""
        network, self._monitor = self._stack.enter_context(open_network(self._config))
        for number in sorted({*self._channels.motors, *self._channels.cells}):
            self._nodes[number] = NodeSetup(network, number, self._config, self._monitor)
        try:
            for number in self._channels.motors:
                self._nodes[number].require_drive()
        except (can.CanError, OSError) as error:
            raise to_driver_fault(self._config, error) from error

    def run_cycle(self, target: Counts | None) -> Sequence[BusReading]:  # noqa: ARG002 - of a Driver
        """Read the position of every motor and the value of every cell."""
        analogue = self._config.analogue
        began_s = time.monotonic()
        try:
            position = [self._nodes[k].get(0x6064, 0, True) for k in self._channels.motors]
            cell = [
                self._nodes[k].get(analogue.index, analogue.subindex, True)
                for k in self._channels.cells
            ]
        except (can.CanError, OSError) as error:
            raise to_driver_fault(self._config, error) from error
        for number in self._nodes:
            if emergency := self._monitor.describe_emergency(number):
                raise DriverFault(f"drive {number} reports: {emergency}")
        sampled_s = 0.5 * (began_s + time.monotonic())
        return (BusReading(sampled_s, np.array(position, float), np.array(cell, float)),)

    def stop(self) -> None:
        """Do nothing: no motor was enabled."""

    def summarise(self) -> dict[str, int | float | str]:
        """Return nothing."""
        return {}

    def close(self) -> None:
        """Release the bus."""
        self._stack.close()


NODE_NUMBER_MAX = 127  # node number
ANSWER_S = 0.03  # [s] of a node to a question


def scan(config: Cia402Config) -> Iterator[str]:
    """Ask every node number for its profile; yield a line for each that answers."""
    with open_network(config) as (network, monitor):
        answered = set()
        for number in range(1, NODE_NUMBER_MAX + 1):
            node = NodeSetup(network, number, config, monitor, ANSWER_S)
            try:
                line = node.describe()
            except NoAnswer:
                continue
            except DriverFault as fault:
                line = str(fault)
            answered.add(number)
            yield line
        for number in sorted(set(monitor.nodes) - answered):
            yield f"node {number} {monitor.explain_silence(number, ANSWER_S)}"
        if not answered and (reason := monitor.explain_errors()):
            raise DriverFault(f"{format_bus_name(config)}: {reason}")


def reset(config: Cia402Config, motors: tuple[int, ...]) -> Iterator[str]:
    """Reset the drives' faults; yield the state of each after it."""
    failed = []
    with open_network(config) as (network, monitor):
        for number in motors:
            try:
                state = NodeSetup(network, number, config, monitor).reset_fault()
            except NoAnswer as error:
                failed.append(str(error))
                continue
            if state is DriveState.FAULT:
                failed.append(f"drive {number} has its fault still")
            else:
                yield f"drive {number}: {state.text}"
    if failed:
        raise DriverFault(f"{format_bus_name(config)}: not reset: {', '.join(failed)}")
