"""The settings of the fault detection."""

from dataclasses import dataclass, field
from math import inf

from teleop.config.loading import MAY_BE_INFINITE


@dataclass(frozen=True, slots=True)
class FaultDetectionConfig:
    """Thresholds of the fault detection, the same for each tendon of a rig."""

    slack: float = 0.1  # [N] at the housing: no tension; above the load cells' zero offset
    take_up: float = 0.020  # [m] wound in without tension, for a joint of a single tendon
    # [m] of winding not explained by the tensions, in a joint of two tendons
    misfit: float = 0.0003
    # of elongation and joint travel: relative error of EA, K and pulleys
    misfit_share: float = 0.03
    lag: float = 0.010  # [s] largest lag of a load cell behind its encoder
    cell_range: float = field(default=inf, metadata=MAY_BE_INFINITE)  # [N] of the load cells
    stuck_time: float = 0.1  # [s] of identical readings; well above the period of a slow cell
    stuck_travel: float = 1e-4  # [m] motor motion, measured or commanded, meanwhile
    motor_lag: float = 0.003  # [m] largest tracking error of a motor
    motor_lag_time: float = 0.1  # [s] for which it may be exceeded

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        for name, low, high, unit in (
            ("slack", 0.0, 10.0, "N"),
            ("take_up", 1e-4, 1.0, "m"),
            ("misfit", 1e-5, 0.1, "m"),
            ("misfit_share", 0.0, 0.5, ""),
            ("lag", 0.0, 0.1, "s"),
            ("cell_range", 0.1, inf, "N"),
            ("stuck_time", 0.01, 10.0, "s"),
            ("stuck_travel", 1e-6, 0.1, "m"),
            ("motor_lag", 1e-4, 0.1, "m"),
            ("motor_lag_time", 0.01, 10.0, "s"),
        ):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name}: must be {low:g} to {high:g} {unit}".rstrip())
