"""What `teleop rig` does with CANopen nodes."""

from collections.abc import Iterator

from slave.drivers.cia402.bus import format_bus_name, open_network
from slave.drivers.cia402.config import Cia402Config
from slave.drivers.cia402.set_up import NoAnswer, NodeSetup
from slave.drivers.cia402.state_machine import DriveState
from slave.drivers.driver import DriverFault

NODE_NUMBER_MAX = 127  # node number
ANSWER_S = 0.03  # [s] of a node to a question


def scan(config: Cia402Config) -> Iterator[str]:
    """Ask every node number for its profile; yield a line for each that answers."""
    with open_network(config) as network:
        for number in range(1, NODE_NUMBER_MAX + 1):
            node = NodeSetup(network, number, config, ANSWER_S)
            try:
                line = node.description()
            except NoAnswer:
                continue
            except DriverFault as fault:
                line = str(fault)
            yield line


def reset(config: Cia402Config, motors: tuple[int, ...]) -> Iterator[str]:
    """Reset the drives' faults; yield the state of each after it."""
    failed = []
    with open_network(config) as network:
        for number in motors:
            try:
                state = NodeSetup(network, number, config).reset_fault()
            except NoAnswer as error:
                failed.append(str(error))
                continue
            if state is DriveState.FAULT:
                failed.append(f"drive {number} has its fault still")
            else:
                yield f"drive {number}: {state.text}"
    if failed:
        raise DriverFault(f"{format_bus_name(config)}: not reset: {', '.join(failed)}")
