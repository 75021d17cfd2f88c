"""Motor motions for simulated measurements: pure functions of time, tension and state."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol


class MotionState(NamedTuple):
    """State of a motion between samples."""

    leg: int = 0  # index of the next turning tension
    target: float = 0.0  # [m] last motor command


class MotionSample(NamedTuple):
    """Input of a motion: one sample."""

    time_s: float  # [s] since the start
    tension: float  # [N] measured at the housing
    dt: float  # [s] until the next


class Motion(Protocol):
    """Interface of a motion of one motor."""

    def step(self, memory: MotionState, seen: MotionSample) -> tuple[float, MotionState]:
        """Return the motor command [m] for the next sample, and the new state."""


@dataclass(frozen=True, slots=True)
class Turns:
    """Constant speed, reversing whenever the housing tension reaches the next of `levels`, cyclic.

    With (20 N, 5 N) this is the pull, release and pull of Phee et al. 2009, Fig. 7; with shrinking
    swings it is nested reversals.
    """

    levels: tuple[float, ...]  # [N] no two neighbours alike, last and first included
    speed: float  # [m/s]

    def step(self, memory: MotionState, seen: MotionSample) -> tuple[float, MotionState]:
        """See `Motion`."""
        leg = memory.leg
        if self._direction(leg) * (seen.tension - self._level(leg)) >= 0.0:
            leg += 1
        target = memory.target + self._direction(leg) * self.speed * seen.dt
        return target, MotionState(leg, target)

    def _level(self, leg: int) -> float:
        return self.levels[leg % len(self.levels)]

    def _direction(self, leg: int) -> float:
        return 1.0 if leg == 0 or self._level(leg) > self._level(leg - 1) else -1.0


@dataclass(frozen=True, slots=True)
class Sine:
    """A sine between the start and `stroke`."""

    stroke: float  # [m]
    period: float  # [s]

    def step(self, memory: MotionState, seen: MotionSample) -> tuple[float, MotionState]:
        """See `Motion`."""
        turn = 2.0 * math.pi * (seen.time_s + seen.dt) / self.period
        target = 0.5 * self.stroke * (1.0 - math.cos(turn))
        return target, memory._replace(target=target)


@dataclass(frozen=True, slots=True)
class TensionHold:
    """Keep the tension near `tension` by admittance control: the other tendon of a pair.

    Motor speed `admittance` (tension - measured), with a dead band, limited to `speed`.
    """

    tension: float  # [N]
    speed: float  # [m/s]
    admittance: float = 0.03  # [m/(s N)]
    band: float = 0.1  # [N] to either side, against limit cycles: a short piece of tendon is stiff

    def step(self, memory: MotionState, seen: MotionSample) -> tuple[float, MotionState]:
        """See `Motion`."""
        error = self.tension - seen.tension
        error -= min(max(error, -self.band), self.band)
        speed = min(max(self.admittance * error, -self.speed), self.speed)
        target = memory.target + speed * seen.dt
        return target, memory._replace(target=target)


@dataclass(frozen=True, slots=True)
class MotionScale:
    """Amplitudes and speeds of the motions."""

    peak: float = 20.0  # [N] highest housing tension, of the motions that turn at tensions
    speed: float = 0.004  # [m/s] of those
    stroke: float = 0.010  # [m] of the sine
    period: float = 4.0  # [s] of the sine


def _build_turns(*shares: float) -> Callable[[MotionScale], Motion]:
    return lambda scale: Turns(tuple(share * scale.peak for share in shares), scale.speed)


MOTIONS: dict[str, Callable[[MotionScale], Motion]] = {
    "pull-release-pull": _build_turns(1.0, 0.25),
    "loop": _build_turns(1.0, 0.01),  # for a calibration: to slack and back
    "nested": _build_turns(1.0, 0.2, 0.8, 0.3, 0.65, 0.4),
    "sine": lambda scale: Sine(scale.stroke, scale.period),
}
