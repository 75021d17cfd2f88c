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

from estimator.compiled import jit_compile


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
        self.offset = np.full(len(springs), tension)  # tension of each spring at no travel [N]
        self.stretch_before = tension * total / axial_stiffness
        self.travel = np.zeros(len(lengths) + 2)  # end, beads, end; towards the motor
        self.sliding = np.zeros(len(lengths), dtype=int)  # +1 towards the motor, -1 tip, 0 sticks

    @property
    def tensions(self):
        """Tension of each spring [N], motor first."""
        return self.offset + self.stiffness * (self.travel[:-1] - self.travel[1:])

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
        is_loaded = isinstance(motor, Force)
        value = motor.tension if is_loaded else motor.travel
        spring, rest = 0.0, 0.0
        if isinstance(tip, Spring):
            spring, rest = tip.stiffness, tip.rest
        load = np.nan if isinstance(tip, Position) else getattr(tip, "tension", 0.0)
        travel, sliding, found = _find_equilibrium(
            self.travel, self.sliding, self.stiffness, self.offset, self.limit_motor,
            self.limit_tip, self.drag, is_loaded, value, load, spring, rest,
            tip.travel if isinstance(tip, Position) else 0.0,
        )  # fmt: skip
        if not found:
            raise AssertionError("the chain found no equilibrium")
        self.travel, self.sliding = travel, sliding
        return self


@jit_compile
def _find_equilibrium(
    before, sliding, k, offset, limit_motor, limit_tip, drag,
    motor_loaded, motor_value, load, spring, rest, tip_travel,
):  # fmt: skip
    """Return travels, what slides which way, and whether all of it satisfies Coulomb.

    What slid before is a good guess; where correcting all beads goes in circles, half of them are.
    """
    n = len(before)
    beads = n - 2
    sliding = sliding.copy()
    wrong = np.zeros(beads, dtype=np.int64)
    random = 1
    for attempt in range(20 * n):
        travel = _solve_forces(
            before, sliding, k, offset, limit_motor, limit_tip, drag,
            motor_loaded, motor_value, load, spring, rest, tip_travel,
        )  # fmt: skip
        peak = 0.0
        for i in range(n - 1):
            peak = max(peak, abs(offset[i] + k[i] * (travel[i] - travel[i + 1])))
        slack = 1e-9 * (1.0 + peak)
        count = 0
        for i in range(beads):
            near = offset[i] + k[i] * (travel[i] - travel[i + 1])
            far = offset[i + 1] + k[i + 1] * (travel[i + 1] - travel[i + 2])
            mean = 0.5 * (near + far) + drag
            moved = travel[i + 1] - before[i + 1]
            corrected = sliding[i]
            if limit_motor[i] == 0.0 and limit_tip[i] == 0.0:
                corrected = 1  # no friction holds it
            elif corrected == 0:
                if near - far > limit_motor[i] * mean + slack:
                    corrected = 1
                elif near - far < -limit_tip[i] * mean - slack:
                    corrected = -1
            elif moved * corrected < -1e-14:
                corrected = 0
            wrong[i] = corrected - sliding[i]
            count += wrong[i] != 0
        if count == 0:
            return travel, sliding, True
        for i in range(beads):
            random = (1103515245 * random + 12345) % 2147483648
            if attempt < 15 or random > 1073741824:
                sliding[i] += wrong[i]
    return travel, sliding, False


@jit_compile
def _solve_forces(
    before, sliding, k, offset, limit_motor, limit_tip, drag,
    motor_loaded, motor_value, load, spring, rest, tip_travel,
):  # fmt: skip
    """Return the travels: stuck beads stay, sliding beads carry their limit."""
    n = len(before)
    # row i: lower x[i-1] + diagonal x[i] + upper x[i+1] = right, eliminated from the motor on
    upper, right = np.zeros(n), np.zeros(n)
    for i in range(n):
        low, diagonal, up, value = 0.0, 1.0, 0.0, before[i]
        if i == 0:
            if motor_loaded:
                diagonal, up, value = k[0], -k[0], motor_value - offset[0]
            else:
                value = motor_value
        elif i == n - 1:
            if np.isnan(load):
                value = tip_travel
            else:
                low, diagonal = k[-1], -k[-1] - spring
                value = load - spring * rest - offset[-1]
        elif sliding[i - 1] != 0:
            # T_before (1 - c) - T_after (1 + c) = 2 c drag, each T linear in the travels
            c = (limit_motor[i - 1] if sliding[i - 1] > 0 else -limit_tip[i - 1]) / 2
            low, up = (1 - c) * k[i - 1], (1 + c) * k[i]
            diagonal = -low - up
            value = 2 * c * drag - (1 - c) * offset[i - 1] + (1 + c) * offset[i]
        if i > 0:
            diagonal -= low * upper[i - 1]
            value -= low * right[i - 1]
        upper[i], right[i] = up / diagonal, value / diagonal
    for i in range(n - 2, -1, -1):
        right[i] -= upper[i] * right[i + 1]
    return right
