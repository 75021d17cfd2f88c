"""The joint's own body: inertia, damping, friction, a return spring, end stops, backlash.

All in units of tendon travel at the joint: with a joint pulley of radius r, a travel is an angle
times r, a force a torque over r, a mass an inertia over r^2.
"""

from dataclasses import dataclass
from typing import NamedTuple

from slave.rigs.simulated.plant.environment import STIFFNESS_MAX, TRAVEL_MAX


@dataclass(frozen=True, slots=True)
class BodyConfig:
    """A light joint with a return spring and end stops."""

    mass: float = 0.02  # [kg] inertia over radius squared; 0 = always in balance
    damping: float = 2.0  # [N s/m]
    friction: float = 0.0  # [N] Coulomb, dry
    spring: float = 200.0  # [N/m] towards the start
    pretension: float = 1.0  # [N] of all tendons at the start; a return spring holds a single one
    stops: tuple[float, float] = (-0.030, 0.030)  # [m] of travel; rigid, without rebound
    backlash: float = 0.0  # [m] whole play between the tendons' pulley and the link

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        for name, most, unit in (
            ("mass", 1e3, "kg"),
            ("damping", 1e5, "N s/m"),
            ("friction", 1e3, "N"),
            ("spring", STIFFNESS_MAX, "N/m"),
            ("pretension", 100.0, "N"),
            ("backlash", 0.1, "m"),
        ):
            if not 0.0 <= getattr(self, name) <= most:
                raise ValueError(f"{name}: must be 0 to {most:g} {unit}")
        low, high = self.stops
        if not -TRAVEL_MAX <= low < 0.0 < high <= TRAVEL_MAX:
            raise ValueError(
                f"stops: must be one below and one above 0, within {TRAVEL_MAX:g} m of it"
            )


class Body(NamedTuple):
    """A body's constants."""

    mass: float  # [kg]
    damping: float  # [N s/m]
    friction: float  # [N]
    spring: float  # [N/m]
    pull_back: float  # [N] of the return spring at the start
    stop_low: float  # [m]
    stop_high: float  # [m]
    backlash: float  # [m]


def build_body(config: BodyConfig, tendons: int) -> Body:
    """Return the body that `config` describes, for a joint of one or two tendons."""
    return Body(
        config.mass,
        config.damping,
        config.friction,
        config.spring,
        config.pretension if tendons == 1 else 0.0,
        *config.stops,
        config.backlash,
    )
