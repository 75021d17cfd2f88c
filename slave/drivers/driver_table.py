"""Table of the drivers that a config can name; the library of one is imported when it is opened."""

import importlib
from collections.abc import Iterator
from types import ModuleType
from typing import Any, NamedTuple

from slave.drivers.cia402.config import Cia402Config
from slave.drivers.driver import BusDriver, Channels, DriverFault
from slave.drivers.dynamixel.config import DynamixelConfig
from slave.drivers.microcontroller.config import MicrocontrollerConfig
from slave.drivers.ports import require_lasting_name

DriverConfig = MicrocontrollerConfig | DynamixelConfig | Cia402Config


class DriverEntry(NamedTuple):
    """Where a driver is, and the optional extra that installs its library."""

    driver: str  # module:Class
    reader: str  # the same, of a driver that only reads
    tools: str  # module with `scan` and `reset`
    extra: str


DRIVERS: dict[type[Any], DriverEntry] = {
    MicrocontrollerConfig: DriverEntry(
        "slave.drivers.microcontroller.driver:MicrocontrollerDriver",
        "slave.drivers.microcontroller.driver:MicrocontrollerReader",
        "slave.drivers.microcontroller.driver",
        "serial",
    ),
    DynamixelConfig: DriverEntry(
        "slave.drivers.dynamixel.driver:DynamixelDriver",
        "slave.drivers.dynamixel.bring_up:DynamixelReader",
        "slave.drivers.dynamixel.bring_up",
        "dynamixel",
    ),
    Cia402Config: DriverEntry(
        "slave.drivers.cia402.driver:Cia402Driver",
        "slave.drivers.cia402.bring_up:Cia402Reader",
        "slave.drivers.cia402.bring_up",
        "can",
    ),
}


def open_driver(config: DriverConfig, channels: Channels) -> BusDriver:
    """Return the driver of a config, not started.

    `DriverFault` if its library is missing, or if its port, with motors to be moved, may be another
    adapter's after a replug.
    """
    if channels.motors and not channels.read_only:
        require_lasting_name(
            config.bus.channel if isinstance(config, Cia402Config) else config.port
        )
    entry = DRIVERS[type(config)]
    module, _, name = (entry.reader if channels.read_only else entry.driver).partition(":")
    driver: BusDriver = getattr(_import_module(config, module), name)(config, channels)
    return driver


def scan(config: DriverConfig) -> Iterator[str]:
    """Yield what answers on a bus, one line each; moves and sets nothing. `DriverFault`."""
    lines: Iterator[str] = _import_module(config, DRIVERS[type(config)].tools).scan(config)
    return lines


def reset(config: DriverConfig, motors: tuple[int, ...]) -> Iterator[str]:
    """Reset the faults of motors, by the operator's order; yield a line for each that is reset.

    `DriverFault` at the end, if any of them is not.
    """
    lines: Iterator[str] = _import_module(config, DRIVERS[type(config)].tools).reset(config, motors)
    return lines


def _import_module(config: DriverConfig, module: str) -> ModuleType:
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        extra = DRIVERS[type(config)].extra
        raise DriverFault(format_missing_library(str(error.name), config.type, extra)) from error


def format_missing_library(module: str, driver: str, extra: str) -> str:
    """Return the line that says which package to install."""
    return (
        f"the driver {driver} needs the Python package of {module!r}: "
        f"pip install 'tendon-teleop[{extra}]'"
    )
