"""A haptic device of your own: a hand that swings, whatever it feels.

master: {device: {type: mylab, amplitude: 0.02}}
"""

import math
from dataclasses import dataclass

from master.device import HandState
from master.devices.extension import DeviceExtension


@dataclass(frozen=True)
class SineHandConfig(DeviceExtension):
    """Keys of `master.device` in the config."""

    amplitude: float = 0.01  # [m]
    frequency: float = 0.5  # [Hz]

    def open(self) -> "SineHand":
        return SineHand(self)


class SineHand:
    """Holds the engage switch from 0.5 s on, as an operator must."""

    axes = 1

    def __init__(self, config: SineHandConfig) -> None:
        self._amplitude, self._rate = config.amplitude, 2.0 * math.pi * config.frequency
        self.force = (0.0,)  # [N] that is applied to the hand

    def read(self, time_s: float) -> HandState:
        phase, a = self._rate * time_s, self._amplitude
        return HandState((a * math.sin(phase),), (a * self._rate * math.cos(phase),), time_s > 0.5)

    def write(self, force: tuple[float, ...]) -> None:
        self.force = force

    def close(self) -> None:
        self.force = (0.0,)
