"""A coupling of your own: the tips follow smoothly, and the hand feels how far they lag.

coupling: {type: mylab-lag, time_constant: 0.05}
"""

from dataclasses import dataclass

import numpy as np

from teleop.coupling.extension import CouplingExtension, HandPort, TipMotion, TipPort


@dataclass(frozen=True)
class LagConfig(CouplingExtension):
    """Keys of `coupling` in the config; the same at both sides."""

    time_constant: float = 0.05  # [s]
    stiffness: float = 100.0  # [N/m]

    def open_master(self, _joints: int) -> "LagMaster":
        return LagMaster(self.stiffness)

    def open_slave(self, _joints: int) -> "LagSlave":
        return LagSlave(self.time_constant)


class LagMaster:
    def __init__(self, stiffness: float) -> None:
        self._stiffness = stiffness

    def send(self, hand: HandPort) -> np.ndarray:
        return np.zeros_like(hand.position)  # the command has the hand's position already

    def render(self, tip_force: np.ndarray, received: np.ndarray) -> np.ndarray:
        return tip_force + self._stiffness * received


class LagSlave:
    def __init__(self, time_constant: float) -> None:
        self._time_constant = time_constant

    def move(self, tip: TipPort) -> TipMotion:
        if tip.is_first:
            self._position = tip.position
        lag = tip.position - self._position  # [m]
        velocity = lag / self._time_constant
        self._position = self._position + velocity * min(tip.dt, self._time_constant)
        return TipMotion(self._position, velocity, lag)
