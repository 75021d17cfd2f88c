"""A tendon controller of your own: feedforward of travel and stretch, and a floor of tension.

slave: {controller: {type: mylab-floor, tension: 0.5}}
"""

from dataclasses import dataclass

import numpy as np

from slave.extensions import ControlInput, ControllerExtension


@dataclass(frozen=True)
class FloorConfig(ControllerExtension):
    """Keys of `slave.controller` in the config."""

    tension: float = 0.5  # [N] that no tendon falls below
    gain: float = 0.02  # [m/s/N]

    def open(self, joints: tuple[tuple[int, ...], ...]) -> "Floor":
        return Floor(self, joints)


class Floor:
    """For rigs whose joints share no tendons."""

    def __init__(self, config: FloorConfig, joints: tuple[tuple[int, ...], ...]) -> None:
        self._config = config
        self._joint = np.array([k for k, tendons in enumerate(joints) for _ in tendons])
        self._sign = np.array([s for tendons in joints for s in (1.0, -1.0)[: len(tendons)]])

    def step(self, state: ControlInput) -> np.ndarray:
        wanted = self._sign * state.command[self._joint] + 0.9 * state.elongation
        if state.is_first:
            self._origin = state.motor - wanted
        slack = np.fmax(self._config.tension - state.tension, 0.0)  # [N]
        self._origin += self._config.gain * slack * state.dt
        return self._origin + wanted
