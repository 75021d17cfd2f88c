"""The settings of the fault detection."""

from dataclasses import dataclass
from math import inf

from teleop.config.ranges import RangedConfig, build_ranged_field


@dataclass(frozen=True, slots=True)
class FaultDetectionConfig(RangedConfig):
    """Thresholds of the fault detection, the same for each tendon of a rig."""

    # at the housing: no tension; above the load cells' zero offset
    slack: float = build_ranged_field(0.1, 0.0, 10.0, "N")
    # wound in without tension, for a joint of a single tendon
    take_up: float = build_ranged_field(0.020, 1e-4, 1.0, "m")
    # of winding not explained by the tensions, in a joint of two tendons
    misfit: float = build_ranged_field(0.0003, 1e-5, 0.1, "m")
    # of elongation and joint travel: relative error of EA, K and pulleys
    misfit_share: float = build_ranged_field(0.03, 0.0, 0.5)
    # largest lag of a load cell behind its encoder
    lag: float = build_ranged_field(0.010, 0.0, 0.1, "s")
    cell_range: float = build_ranged_field(inf, 0.1, inf, "N")  # of the load cells
    # of identical readings; well above the period of a slow cell
    stuck_time: float = build_ranged_field(0.1, 0.01, 10.0, "s")
    # motor motion, measured or commanded, meanwhile
    stuck_travel: float = build_ranged_field(1e-4, 1e-6, 0.1, "m")
    # largest tracking error of a motor
    motor_lag: float = build_ranged_field(0.003, 1e-4, 0.1, "m")
    motor_lag_time: float = build_ranged_field(0.1, 0.01, 10.0, "s")  # for which it may be exceeded
