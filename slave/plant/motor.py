"""A motor that winds the tendon, under position control of its own."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estimator.compiled import compiled


@dataclass(frozen=True, slots=True)
class MotorConfig:
    """A position servo as the tendon sees it: first-order lag and a speed limit."""

    time_constant: float = 0.010  # [s]
    speed_max: float = 0.050  # [m/s] of the tendon

    def __post_init__(self) -> None:
        """Refuse a servo that is ahead of its command or never moves."""
        if not 0.0 < self.time_constant <= 10.0:
            raise ValueError("time_constant: must be above 0 and at most 10 s")
        if not 0.0 < self.speed_max <= 10.0:
            raise ValueError("speed_max: must be above 0 and at most 10 m/s")


class Motor(NamedTuple):
    """A motor's constants."""

    time_constant: float  # [s]
    speed_max: float  # [m/s]


def build_motor(config: MotorConfig) -> Motor:
    """Return the motor that `config` describes."""
    return Motor(config.time_constant, config.speed_max)


@compiled
def follow(motor: Motor, position: float, target: float, dt: float) -> float:
    """Return the position [m] after `dt` [s] of following `target` [m]."""
    step = (target - position) * (1.0 - np.exp(-dt / motor.time_constant))
    reach = motor.speed_max * dt
    return float(position + min(max(step, -reach), reach))
