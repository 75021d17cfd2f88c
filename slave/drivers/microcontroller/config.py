"""Config of a microcontroller on a serial line."""

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

from teleop.config.ranges import build_ranged_field, check_ranges


@dataclass(frozen=True, slots=True, kw_only=True)
class MicrocontrollerConfig:
    """A board with the firmware of `firmware/`; motors and cells are numbered from 1."""

    NUMBERS: ClassVar[range] = range(1, 256)  # of motors and cells
    type: Literal["microcontroller"] = "microcontroller"
    port: str  # /dev/serial/by-id/..., which does not change with the order of plugging in
    # of a real UART; USB takes any
    baud: int = build_ranged_field(2_000_000, 1200, 20_000_000)
    # without a target the board stops its motors
    watchdog: float = build_ranged_field(0.040, 0.005, 0.050, "s")
    # without a valid frame the board counts as silent
    timeout: float = build_ranged_field(0.050, 0.005, 0.5, "s")
    # damaged or lost frames in a second; more are a fault
    errors_max: int = build_ranged_field(20, 0, math.inf)

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.port:
            raise ValueError("port: must not be empty")
