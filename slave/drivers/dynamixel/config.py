"""Config of Dynamixel servos."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from teleop.config.ranges import build_ranged_field, check_ranges

WATCHDOG_UNIT = 0.020  # [s]


@dataclass(frozen=True, slots=True, kw_only=True)
class DynamixelConfig:
    """Servos of protocol 2.0 with the X series' control table, on one adapter (U2D2 or alike)."""

    NUMBERS: ClassVar[range] = range(253)  # of servos
    type: Literal["dynamixel"] = "dynamixel"
    port: str  # /dev/serial/by-id/...
    # set in the servos too: `teleop rig scan`
    baud: int = build_ranged_field(4_000_000, 9600, 20_000_000)
    rate_hz: float = build_ranged_field(250.0, 20.0, 1000.0, "Hz")  # of sync read and sync write
    watchdog: float = 0.040  # [s] without an instruction a servo stops; a multiple of 20 ms
    # without an answer of every servo the bus counts as silent
    timeout: float = build_ranged_field(0.050, 0.01, 0.5, "s")
    # for the answers to one sync read, beyond their own time on the line
    wait: float = build_ranged_field(0.004, 0.001, 0.020, "s")
    voltage: tuple[float, float] = (10.0, 14.8)  # [V] of the supply; outside is a fault
    # of a servo; beyond is a fault
    temperature_max: float = build_ranged_field(70.0, 20.0, 100.0, "deg C")
    # of each servo, by operating mode 5; null: no limit
    current_limit: float | None = build_ranged_field(None, 0.01, 20.0, "A")
    # of the shaft, set in the servos
    velocity_max: float = build_ranged_field(4.0, 0.1, 100.0, "rad/s")

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.port:
            raise ValueError("port: must not be empty")
        if self.watchdog not in (0.020, 0.040):
            raise ValueError("watchdog: must be 0.02 or 0.04 s")
        if not 0.0 < self.voltage[0] < self.voltage[1] <= 60.0:
            raise ValueError("voltage: must be two voltages, the lower first")
