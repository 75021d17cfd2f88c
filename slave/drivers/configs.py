"""Table of the drivers that a config can name; the library of one is imported when it is opened."""

import importlib
from typing import Any, NamedTuple

from slave.drivers.cia402.config import Cia402Config
from slave.drivers.driver import Channels, Driver, DriverFault
from slave.drivers.dynamixel.config import DynamixelConfig
from slave.drivers.microcontroller.config import MicrocontrollerConfig

DriverConfig = MicrocontrollerConfig | DynamixelConfig | Cia402Config


class DriverEntry(NamedTuple):
    """Where a driver is, and the optional extra that installs its library."""

    driver: str  # module:Class
    extra: str


DRIVERS: dict[type[Any], DriverEntry] = {
    MicrocontrollerConfig: DriverEntry(
        "slave.drivers.microcontroller.driver:MicrocontrollerDriver", "serial"
    ),
    DynamixelConfig: DriverEntry("slave.drivers.dynamixel.driver:DynamixelDriver", "dynamixel"),
    Cia402Config: DriverEntry("slave.drivers.cia402.driver:Cia402Driver", "can"),
}


def open_driver(config: DriverConfig, channels: Channels) -> Driver:
    """Return the driver of a config, not started; `DriverFault` if its library is missing."""
    entry = DRIVERS[type(config)]
    module, _, name = entry.driver.partition(":")
    try:
        found: Driver = getattr(importlib.import_module(module), name)(config, channels)
    except ModuleNotFoundError as error:
        raise DriverFault(missing_library(str(error.name), config.type, entry.extra)) from error
    return found


def missing_library(module: str, driver: str, extra: str) -> str:
    """Return the line that says which package to install."""
    return (
        f"the driver {driver} needs the Python package of {module!r}: "
        f"pip install 'tendon-teleop[{extra}]'"
    )
