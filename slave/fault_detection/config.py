"""The settings of the fault detection."""

from dataclasses import dataclass, field
from math import inf

from teleop.config import MAY_BE_INFINITE


@dataclass(frozen=True, slots=True)
class FaultDetectionConfig:
    """What counts as a fault, the same for each tendon of one rig."""

    slack: float = 0.1  # [N] at the housing: no tension; above the load cells' zero offset
    take_up: float = 0.020  # [m] reeled in without tension, where no other tendon tells more
    misfit: float = 0.0003  # [m] of winding that no tensions explain, in a joint of two tendons
    misfit_share: float = 0.03  # of elongation and joint travel; what EA, K, pulleys are wrong by
    lag: float = 0.010  # [s] by which a load cell may lag its encoder
    cell_range: float = field(default=inf, metadata=MAY_BE_INFINITE)  # [N] of the load cells
    stuck_time: float = 0.1  # [s] of identical readings; well above the period of a slow cell
    stuck_travel: float = 1e-4  # [m] that the motor went, or was sent, meanwhile
    motor_lag: float = 0.003  # [m] from where a motor was sent to where its encoder has it
    motor_lag_time: float = 0.1  # [s] for which it may be further

    def __post_init__(self) -> None:
        """Refuse what would never, or always, be a fault."""
        for name, least, most, unit in (
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
            if not least <= getattr(self, name) <= most:
                raise ValueError(f"{name}: must be {least:g} to {most:g} {unit}".rstrip())
