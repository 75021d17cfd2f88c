"""What `teleop rig` does with a microcontroller."""

from collections.abc import Iterator

from slave.drivers.driver import Channels
from slave.drivers.microcontroller.config import MicrocontrollerConfig
from slave.drivers.microcontroller.driver import MicrocontrollerDriver


def scan(config: MicrocontrollerConfig) -> Iterator[str]:
    """Greet the board; yield what it says it is."""
    driver = MicrocontrollerDriver(config, Channels())
    try:
        driver.start()
        info = driver.info
    finally:
        driver.close()
    if info is not None:
        what = f"{info.motors} motors, {info.cells} cells, {info.rate_hz} Hz"
        yield f"{config.port}: {info.name}, {what}"


def reset(config: MicrocontrollerConfig, motors: tuple[int, ...]) -> Iterator[str]:  # noqa: ARG001
    """Yield that there is nothing to reset from here."""
    yield f"{config.port}: its faults end with their cause; restart the board if they do not"
