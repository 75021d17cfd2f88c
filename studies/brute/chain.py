"""A tendon as a chain of springs and Coulomb-friction beads, solved for quasi-static equilibrium.

Nothing here knows the law under test. Each bead sits in the middle of an element of sheath, carries
that element's bend angle and obeys Coulomb: the tension may jump across it by at most

    friction * angle * (mean tension + drag)

towards the motor, rho times that towards the tip; it slides only when the jump is at the limit,
and only the way the jump drives it. Both ends of the chain are free of friction. For each change of
the boundary the beads are guessed to stick or to slide one way, the linear equilibrium is solved,
and the guesses that Coulomb contradicts are corrected until none is left: a result that is
returned satisfies every condition, however it was found.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_banded


@dataclass(frozen=True)
class Force:
    """An end loaded with a tension [N]."""

    tension: float


@dataclass(frozen=True)
class Position:
    """An end held at a travel [m], positive towards the motor."""

    travel: float


@dataclass(frozen=True)
class Spring:
    """A tip tied to a spring: tension = stiffness * (travel - rest)."""

    stiffness: float  # [N/m]
    rest: float = 0.0  # [m]


class Chain:
    """The chain and its present equilibrium; `move` takes it to the next one."""

    def __init__(
        self,
        sections,
        friction,
        axial_stiffness,
        *,
        beads=120,
        drag=0.0,
        asymmetry=1.0,
        tension=0.0,
    ):
        """Lay `sections`, pairs of (length, radius), with about `beads` beads, at one `tension`."""
        total = sum(length for length, _ in sections)
        lengths, angles = [], []
        for length, radius in sections:
            count = max(1, round(beads * length / total))
            lengths += [length / count] * count
            angles += [length / count / radius] * count
        halves = np.array(lengths) / 2
        springs = np.concatenate([[0.0], halves]) + np.concatenate([halves, [0.0]])
        self.stiffness = axial_stiffness / springs
        self.lengths = springs
        self.limit_motor = friction * np.array(angles)
        self.limit_tip = asymmetry * self.limit_motor
        self.drag = drag
        self.pretension = tension
        self.stretch_before = tension * total / axial_stiffness
        self.travel = np.zeros(len(lengths) + 2)  # end, beads, end; towards the motor
        self.sliding = np.zeros(len(lengths), dtype=int)  # +1 towards the motor, -1 tip, 0 sticks

    @property
    def tensions(self):
        """Tension of each spring [N], motor first."""
        return self.pretension + self.stiffness * (self.travel[:-1] - self.travel[1:])

    @property
    def T_in(self):  # noqa: N802
        return self.tensions[0]

    @property
    def T_out(self):  # noqa: N802
        return self.tensions[-1]

    @property
    def elongation(self):
        """Travel at the motor that does not arrive at the tip, from the unloaded tendon [m]."""
        return self.stretch_before + self.travel[0] - self.travel[-1]

    def move(self, motor, tip):
        """Take the chain to equilibrium: Force or Position at each end, or a Spring at the tip."""
        before = self.travel
        # What slid before is a good guess; where correcting it goes in circles, start from rest.
        for guess in (self.sliding, np.zeros_like(self.sliding)):
            self.sliding = guess
            for _ in range(2 * len(guess)):
                self.travel = self._equilibrium(before, motor, tip)
                corrected = self._corrected(before)
                if np.array_equal(corrected, self.sliding):
                    return self
                self.sliding = corrected
        raise AssertionError("the chain found no equilibrium")

    def _limits(self):
        tensions = self.tensions
        load = (tensions[:-1] + tensions[1:]) / 2 + self.drag
        return self.limit_motor * load, self.limit_tip * load

    def _corrected(self, before):
        tensions = self.tensions
        jump = tensions[:-1] - tensions[1:]
        towards_motor, towards_tip = self._limits()
        moved = (self.travel - before)[1:-1]
        slack = 1e-12 * (1.0 + np.abs(tensions).max())
        corrected = self.sliding.copy()
        stuck = self.sliding == 0
        corrected[stuck & (jump > towards_motor + slack)] = 1
        corrected[stuck & (jump < -towards_tip - slack)] = -1
        corrected[~stuck & (moved * self.sliding < -1e-15)] = 0
        return corrected

    def _equilibrium(self, before, motor, tip):
        """Solve for the travels: stuck beads stay, sliding beads carry their limit."""
        n = len(before)
        lower, diagonal, upper, right = np.zeros(n), np.ones(n), np.zeros(n), before.copy()
        k = self.stiffness
        c = np.where(self.sliding > 0, self.limit_motor, -self.limit_tip) / 2
        # T_before (1 - c) - T_after (1 + c) = 2 c drag, each T linear in the travels
        slides = np.flatnonzero(self.sliding)
        node = slides + 1
        first, second = (1 - c[slides]) * k[slides], (1 + c[slides]) * k[slides + 1]
        lower[node], diagonal[node], upper[node] = first, -first - second, second
        right[node] = 2 * c[slides] * (self.drag + self.pretension)
        if isinstance(motor, Force):
            diagonal[0], upper[0], right[0] = k[0], -k[0], motor.tension - self.pretension
        else:
            right[0] = motor.travel
        if isinstance(tip, Force):
            lower[-1], diagonal[-1], right[-1] = k[-1], -k[-1], tip.tension - self.pretension
        elif isinstance(tip, Spring):
            lower[-1], diagonal[-1] = k[-1], -k[-1] - tip.stiffness
            right[-1] = -tip.stiffness * tip.rest - self.pretension
        else:
            right[-1] = tip.travel
        banded = np.array([np.roll(upper, 1), diagonal, np.roll(lower, -1)])
        return solve_banded((1, 1), banded, right)
