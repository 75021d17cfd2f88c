"""Reference motions of a scripted hand: position and velocity as functions of time."""

import math
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class Hold:
    """A hand that stays where it is."""

    type: Literal["hold"] = "hold"
    position: float = 0.0  # [m]

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        if not math.isfinite(self.position):
            raise ValueError("position: must be finite [m]")

    def at(self, time_s: float) -> tuple[float, float]:  # noqa: ARG002 - one signature for all
        """Return position [m] and velocity [m/s]."""
        return self.position, 0.0


@dataclass(frozen=True, slots=True)
class Sine:
    """A sine: x = offset + amplitude * sin(2 pi frequency t)."""

    type: Literal["sine"] = "sine"
    amplitude: float = 0.02  # [m]
    frequency: float = 0.5  # [Hz]; people move freely up to about 5 Hz
    offset: float = 0.0  # [m]

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        if not 0.0 <= self.amplitude <= 1.0:
            raise ValueError("amplitude: must be within 0 ... 1 [m]")
        if not 0.0 <= self.frequency <= 20.0:
            raise ValueError("frequency: must be within 0 ... 20 [Hz]")
        if not math.isfinite(self.offset):
            raise ValueError("offset: must be finite [m]")

    def at(self, time_s: float) -> tuple[float, float]:
        """Return position [m] and velocity [m/s]."""
        rate = 2.0 * math.pi * self.frequency
        angle = rate * time_s
        return (
            self.offset + self.amplitude * math.sin(angle),
            self.amplitude * rate * math.cos(angle),
        )


@dataclass(frozen=True, slots=True)
class Reaches:
    """Cyclic minimum-jerk reaches from target to target, each followed by a rest.

    Over a reach from a to b, with s = t / reach: x = a + (b - a) (10 s^3 - 15 s^4 + 6 s^5)
    (Flash & Hogan 1985). The first reach starts at zero.
    """

    type: Literal["reaches"] = "reaches"
    targets: tuple[float, ...] = (0.0, 0.05, 0.02, 0.04, 0.01, 0.055)  # [m] nested reversals
    reach: float = 0.8  # [s] duration of each reach
    rest: float = 0.3  # [s] at each target

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        if not self.targets or not all(math.isfinite(target) for target in self.targets):
            raise ValueError("targets: at least one, all finite [m]")
        if not 0.0 < self.reach < math.inf:
            raise ValueError("reach: must be above 0 and finite [s]")
        if not 0.0 <= self.rest < math.inf:
            raise ValueError("rest: must be at least 0 and finite [s]")

    def at(self, time_s: float) -> tuple[float, float]:
        """Return position [m] and velocity [m/s]."""
        count, within = divmod(max(time_s, 0.0), self.reach + self.rest)
        number = int(count)
        goal = self.targets[number % len(self.targets)]
        start = self.targets[(number - 1) % len(self.targets)] if number else 0.0
        s = min(within / self.reach, 1.0)
        way = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
        speed = 30.0 * s * s * (1.0 - s) * (1.0 - s) / self.reach
        return start + (goal - start) * way, (goal - start) * speed


Reference = Hold | Sine | Reaches
