"""Whether what two motors have wound in agrees with the tensions of their tendons.

The tips of a joint's two tendons travel by q and -q, so that what both motors have wound in is what
both tendons are stretched by, and a constant:

    q_p,a + q_p,b = e_a + e_b + c.

Whatever moved a tendon of housing tension T, and whichever end drove, friction lets its elongation
be anything from e(T) of a pull to e(T) of a release and nothing else (docs/theory.md (T2), (T4)),

    M_pull (T + tau) - tau L/EA  <=  e  <=  M_rel (T + tau) - tau L/EA,

and anything below where it is slack. So each sample tells an interval for c, and all samples must
have one in common. If it lies above those before, a slack tendon was wound in by more than there
is: it is broken. If it lies below, a tendon has more tension than its stretch allows: it is jammed,
and stretched between motor and jam alone.
"""

from math import inf, isfinite, nan
from typing import NamedTuple

from estimator import tables
from estimator.online import Prepared
from slave.watch.config import WatchConfig
from slave.watch.slack import Slack
from teleop.session import Reason

TIME_CONSTANT = 0.005  # [s] of the averages: noise must not decide
SURE_TIME = 0.010  # [s] that a misfit lasts before it is one
FORGET = 2e-5  # [m/s] by which the interval for c opens: creep, warmth


class Compliance(NamedTuple):
    """How far a tension stretches a tendon, least and most."""

    pull: float  # M_pull [m/N]
    release: float  # M_rel [m/N]
    drag: float  # tau [N]
    rest: float  # tau L/EA [m]

    def least(self, tension: float) -> float:
        """Return the least elongation [m] of a taut tendon with `tension` [N] at the housing."""
        return max(self.pull * (tension + self.drag) - self.rest, 0.0)

    def most(self, tension: float) -> float:
        """Return the largest elongation [m] of a tendon with `tension` [N] at the housing."""
        return self.release * (max(tension, 0.0) + self.drag) - self.rest


class Winding(NamedTuple):
    """What is remembered of a joint's two tendons."""

    low: float = -inf  # [m] interval for c by all samples
    high: float = inf
    above: float = 0.0  # [s] for which a sample lies above it
    below: float = 0.0  # [s] for which a sample lies below it


class Wound(NamedTuple):
    """One tendon, averaged."""

    tension: float  # [N]
    displacement: float  # [m]
    speed: float  # [m/s]


NEVER = Wound(nan, nan, nan)


def compliance(prepared: Prepared) -> Compliance:
    """Return the compliance of a tendon as the estimator models it."""
    table = prepared.tables
    K, EA, rho = table[tables.K], table[tables.EA], table[tables.ASYMMETRY]
    drag = table[tables.DRAG]
    return Compliance(
        float(tables.integral(table, K, -1.0) / EA),
        float(tables.integral(table, K, rho) / EA),
        float(drag),
        float(drag * table[tables.LENGTH] / EA),
    )


def average(before: Wound, tension: float, displacement: float, dt: float) -> Wound:
    """Return the averages after a sample `dt` [s] later; they begin anew where there were none."""
    T, q, speed = before
    if not isfinite(q):
        return Wound(tension, displacement, 0.0)
    if not dt > 0.0:
        return before
    share = dt / (dt + TIME_CONSTANT)
    moved = share * (displacement - q)
    return Wound(T + share * (tension - T), q + moved, speed + share * (moved / dt - speed))


def watch_winding(
    config: WatchConfig,
    winding: Winding,
    tendons: tuple[Wound, Wound],
    compliances: tuple[Compliance, Compliance],
    slacks: tuple[Slack, Slack],
    dt: float,
) -> tuple[Reason, int, Winding]:
    """Return what is wrong, with which of a joint's two tendons, and the new memory.

    Where both are slack, as the joint flew off, the broken one was so first; as soon as the other,
    the tighter one.

    Parameters
    ----------
    tendons, compliances : tuples of two
        `a` and `b`, averaged over the same samples, and how far tensions stretch them.
    slacks : tuple of two
        For how long they have had no tension.
    dt : float
        Time since the last sample [s].
    """
    a, b = tendons
    of_a, of_b = compliances
    wound = a.displacement + b.displacement
    least_a, least_b = of_a.least(a.tension), of_b.least(b.tension)
    joint_travel = 0.5 * abs(a.displacement - b.displacement)
    unsure = config.misfit_share * (least_a + least_b + joint_travel)
    unsure += config.lag * (abs(a.speed) + abs(b.speed))
    low = wound - of_a.most(a.tension) - of_b.most(b.tension) - unsure
    taut = min(a.tension, b.tension) > config.slack
    high = wound - least_a - least_b + unsure if taut else inf
    above = winding.above + dt if low > winding.high + config.misfit and not taut else 0.0
    below = winding.below + dt if high < winding.low - config.misfit else 0.0
    known_low, known_high = winding.low, winding.high
    if above == below == 0.0:
        known_low = max(known_low - FORGET * dt, low)
        known_high = min(known_high + FORGET * dt, high)
    after = Winding(known_low, known_high, above, below)
    if above >= SURE_TIME:
        return Reason.TENDON_BROKEN, int(slacks[1] > slacks[0]), after
    if below >= SURE_TIME:
        return Reason.TENDON_JAMMED, int(least_b > least_a), after
    return Reason.NONE, 0, after
