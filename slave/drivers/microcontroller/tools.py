"""What `teleop rig` does with a microcontroller."""

from slave.drivers.driver import Channels
from slave.drivers.microcontroller.config import MicrocontrollerConfig
from slave.drivers.microcontroller.driver import MicrocontrollerDriver


def scan(config: MicrocontrollerConfig) -> list[str]:
    """Greet the board; return what it says it is."""
    driver = MicrocontrollerDriver(config, Channels())
    try:
        driver.start()
        info = driver.info
    finally:
        driver.close()
    if info is None:
        return []
    return [
        f"{config.port}: {info.name}, {info.motors} motors, {info.cells} cells, {info.rate_hz} Hz"
    ]


def reset(config: MicrocontrollerConfig, motors: tuple[int, ...]) -> list[str]:  # noqa: ARG001
    """Return that there is nothing to reset from here."""
    return [f"{config.port}: its faults end with their cause; restart the board if they do not"]
