"""Config of a microcontroller on a serial line."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from slave.ranged_field import build_ranged_field, check_ranges


@dataclass(frozen=True, slots=True, kw_only=True)
class MicrocontrollerConfig:
    """A board with the firmware of `firmware/`; motors and cells are numbered from 1."""

    NUMBERS: ClassVar[range] = range(1, 256)  # of motors and cells
    type: Literal["microcontroller"] = "microcontroller"
    port: str  # /dev/serial/by-id/..., which does not change with the order of plugging in
    baud: int = 2_000_000  # of a real UART; USB takes any
    # without a target the board stops its motors
    watchdog: float = build_ranged_field(0.040, 0.005, 0.050, "s")
    # without a valid frame the board counts as silent
    timeout: float = build_ranged_field(0.050, 0.005, 0.5, "s")
    errors_max: int = 20  # damaged or lost frames in a second; more are a fault

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        check_ranges(self)
        if not self.port:
            raise ValueError("port: must not be empty")
        if not 1200 <= self.baud <= 20_000_000:
            raise ValueError("baud: must be 1200 to 20000000")
        if self.errors_max < 0:
            raise ValueError("errors_max: must not be negative")
