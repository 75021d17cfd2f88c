"""What `teleop rig` does with CANopen nodes."""

from collections.abc import Iterator
from contextlib import contextmanager

import canopen

from slave.drivers.cia402 import set_up
from slave.drivers.cia402.config import Cia402Config
from slave.drivers.cia402.driver import open_bus
from slave.drivers.cia402.set_up import NodeSetUp
from slave.drivers.driver import DriverFault

HIGHEST = 127  # node number
ANSWER_S = 0.03  # [s] of a node to a question


def scan(config: Cia402Config) -> list[str]:
    """Ask every node number for its profile; return a line for each that answers."""
    lines = []
    with _network(config) as network:
        for number in range(1, HIGHEST + 1):
            node = NodeSetUp(network, number, config, ANSWER_S)
            try:
                lines.append(node.description())
            except DriverFault:
                continue
    return lines


def reset(config: Cia402Config, motors: tuple[int, ...]) -> list[str]:
    """Reset the drives' faults; return the state of each after it."""
    with _network(config) as network:
        return [
            f"drive {number}: "
            f"{NodeSetUp(network, number, config, set_up.SDO_TIMEOUT_S).reset_fault()}"
            for number in motors
        ]


@contextmanager
def _network(config: Cia402Config) -> Iterator[canopen.Network]:
    network = canopen.Network(open_bus(config))
    network.connect()
    try:
        yield network
    finally:
        network.disconnect()
