"""Table of the drivers that a config can name; the library of one is imported when it is opened."""

import importlib
from types import ModuleType
from typing import Any, NamedTuple

from slave.drivers.cia402.config import Cia402Config
from slave.drivers.driver import Channels, Driver, DriverFault
from slave.drivers.dynamixel.config import DynamixelConfig
from slave.drivers.microcontroller.config import MicrocontrollerConfig

DriverConfig = MicrocontrollerConfig | DynamixelConfig | Cia402Config


class DriverEntry(NamedTuple):
    """Where a driver is, and the optional extra that installs its library."""

    driver: str  # module:Class
    tools: str  # module with `scan` and `reset`
    extra: str


DRIVERS: dict[type[Any], DriverEntry] = {
    MicrocontrollerConfig: DriverEntry(
        "slave.drivers.microcontroller.driver:MicrocontrollerDriver",
        "slave.drivers.microcontroller.tools",
        "serial",
    ),
    DynamixelConfig: DriverEntry(
        "slave.drivers.dynamixel.driver:DynamixelDriver",
        "slave.drivers.dynamixel.tools",
        "dynamixel",
    ),
    Cia402Config: DriverEntry(
        "slave.drivers.cia402.driver:Cia402Driver", "slave.drivers.cia402.tools", "can"
    ),
}


def open_driver(config: DriverConfig, channels: Channels) -> Driver:
    """Return the driver of a config, not started; `DriverFault` if its library is missing."""
    module, _, name = DRIVERS[type(config)].driver.partition(":")
    found: Driver = getattr(_imported(config, module), name)(config, channels)
    return found


def scan(config: DriverConfig) -> list[str]:
    """Return what answers on a bus, one line each; moves and sets nothing. `DriverFault`."""
    lines: list[str] = _imported(config, DRIVERS[type(config)].tools).scan(config)
    return lines


def reset(config: DriverConfig, motors: tuple[int, ...]) -> list[str]:
    """Reset the faults of motors, by the operator's order; return a line each. `DriverFault`."""
    lines: list[str] = _imported(config, DRIVERS[type(config)].tools).reset(config, motors)
    return lines


def _imported(config: DriverConfig, module: str) -> ModuleType:
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        extra = DRIVERS[type(config)].extra
        raise DriverFault(missing_library(str(error.name), config.type, extra)) from error


def missing_library(module: str, driver: str, extra: str) -> str:
    """Return the line that says which package to install."""
    return (
        f"the driver {driver} needs the Python package of {module!r}: "
        f"pip install 'tendon-teleop[{extra}]'"
    )
