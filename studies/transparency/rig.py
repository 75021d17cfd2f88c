"""A minimal rig: a motor with lag, a spring, a tip, an environment.

There is no friction, and the tip has no mass. It is the ground truth of the tests of the coupling.
"""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from slave.rig import RigSample
from studies.transparency.hand import DT

Environment = Callable[[float], float]  # [N] against the tip's travel [m], never falling

TENDON = 9000.0 / 1.5  # [N/m]
STEPS = 10  # of the motor in a tick
NOISE = 0.01  # [N] of the measured tension


class TestRig(Protocol):
    """Interface of a rig for the study."""

    tip: float  # [m] true
    wanted: tuple[float, ...] | None  # [m] where the motors shall go; None: nothing was asked yet

    def advance(self, push: float) -> None:
        """Go on by a tick, at whose end the tip is pushed by `push` [N] besides all else."""

    def read(self) -> Sequence[RigSample]:
        """Return the samples of the tick."""

    def load(self) -> float:
        """Return the true force on the tip [N]."""


class Rig:
    """One tendon: a motor of 12.5 ms lag and at most 0.1 m/s, a tip pulled back.

    Parameters
    ----------
    environment : callable
        Force of the environment.
    spring, pretension : float
        The load besides: `pretension` [N] at rest, more by `spring` [N/m].
    """

    lag, speed = 0.0125, 0.1  # [s], [m/s] of the motor

    def __init__(
        self, environment: Environment, spring: float = 200.0, pretension: float = 1.0
    ) -> None:
        self._environment, self._spring, self._pretension = environment, spring, pretension
        self._rng = np.random.default_rng(0)
        self._motor = pretension / TENDON
        self.wanted: tuple[float, ...] | None = None
        self._time = self.tip = self._push = 0.0

    def load(self) -> float:
        """See `TestRig`."""
        return self._compute_load(self.tip)

    def advance(self, push: float = 0.0) -> None:
        """See `TestRig`."""
        wanted = self._motor if self.wanted is None else self.wanted[0]
        for _ in range(STEPS):
            speed = (wanted - self._motor) / self.lag
            self._motor += DT / STEPS * min(max(speed, -self.speed), self.speed)
        self._time += DT
        self._push = push
        self.tip = self._balance()

    def read(self) -> list[RigSample]:
        """See `TestRig`."""
        tension = self._compute_tension(self.tip) + self._rng.normal(0.0, NOISE)
        return [RigSample(self._time, np.array([tension]), np.array([self._motor]))]

    def _compute_tension(self, q: float) -> float:
        return max(TENDON * (self._motor - q), 0.0)

    def _compute_load(self, q: float) -> float:
        return self._pretension + self._spring * q + self._environment(q) + self._push

    def _balance(self) -> float:
        """Return where tension and load meet [m]: the one falls with q, the other rises.

        By the Illinois method, to a force of 1e-9 N.
        """
        low, high = -0.1, 0.2
        below, above = (self._compute_tension(q) - self._compute_load(q) for q in (low, high))
        q = self.tip
        for _ in range(100):
            rest = self._compute_tension(q) - self._compute_load(q)
            if abs(rest) < 1e-9:
                break
            if rest > 0.0:
                low, below, above = q, rest, 0.5 * above
            else:
                high, above, below = q, rest, 0.5 * below
            q = low + (high - low) * below / (below - above)
        return q


def press_nothing(_q: float) -> float:
    """No contact."""
    return 0.0


def build_wall(stiffness: float, position: float = 0.0015) -> Environment:
    """Return a wall of `stiffness` [N/m] that begins at `position` [m]."""
    return lambda q: stiffness * max(q - position, 0.0)


def press_tissue(q: float) -> float:
    """Return the force of tissue that begins at 1.5 mm: 9400 N/m^1.5 by its depth."""
    return float(9400.0 * max(q - 0.0015, 0.0) ** 1.5)
