"""Force balance of a link at the end of a step: tendons against all resistance.

    T_a(q) - T_b(-q) = base + slope (q - q_before) + friction sgn(q - q_before) + F_environment(q)

The left side is non-increasing in q and the right one non-decreasing, so the solution is unique if
there is any resistance. While q = q_before friction may take any value within its limits: a stuck
link stays exactly where it is. Within its backlash the tendons' pulley turns without the link.
"""

from typing import NamedTuple

from estimator.compiled import jit_compile
from slave.rigs.simulated.plant.environment import Environment, compute_environment_force
from slave.rigs.simulated.plant.response import Curve, interpolate_curve

MAX_ITERATIONS = 200  # of the root search; about ten are needed
FORCE_TOLERANCE = 1e-11  # [N] of balance


class JointResponse(NamedTuple):
    """Tension responses of the tendons of a joint to the position of its pulley in this step."""

    a: Curve
    b: Curve
    pair: bool  # without it there is no `b`


class Resistance(NamedTuple):
    """Resistance of a link to motion, without its environment."""

    base: float  # [N] at the start of the step
    slope: float  # [N/m]
    friction: float  # [N]
    backlash: float  # [m] whole play between pulley and link


@jit_compile
def compute_pulley_tensions(answer: JointResponse, pulley: float) -> tuple[float, float]:
    """Return the tensions of `a` and `b` [N] with the joint's pulley at `pulley` [m]."""
    a = interpolate_curve(answer.a, pulley)
    if not answer.pair:
        return a, 0.0
    return a, interpolate_curve(answer.b, -pulley)


@jit_compile
def compute_drive_force(answer: JointResponse, travel: float, backlash: float) -> float:
    """Return the force [N] of the tendons on a link at `travel` [m], through its backlash."""
    a, b = compute_pulley_tensions(answer, travel + 0.5 * backlash)
    if backlash == 0.0:
        return a - b
    forward = a - b
    a, b = compute_pulley_tensions(answer, travel - 0.5 * backlash)
    return max(0.0, forward) + min(0.0, a - b)


@jit_compile
def compute_force_residual(
    answer: JointResponse,
    resistance: Resistance,
    environment: Environment,
    travel: float,
    before: float,
    time: float,
    dt: float,
) -> float:
    """Return resistance less driving force [N] for a move to `travel`."""
    against = resistance.base + resistance.slope * (travel - before)
    against += compute_environment_force(environment, travel, before, time, dt)
    return against - compute_drive_force(answer, travel, resistance.backlash)


@jit_compile
def solve_balance(
    answer: JointResponse,
    resistance: Resistance,
    environment: Environment,
    before: float,
    low: float,
    high: float,
    time: float,
    dt: float,
) -> float:
    """Return the travel [m] between `low` and `high` of a link in force balance.

    Bracketed by the old position and a stop, solved by the Illinois variant of the secant method:
    the forces are nearly piecewise linear.

    Parameters
    ----------
    before : float
        Where the link was [m].
    time, dt : float
        The end of the step [s] and its length [s].
    """
    excess = compute_force_residual(answer, resistance, environment, before, before, time, dt)
    if abs(excess) <= resistance.friction:
        return before
    sense = -1.0 if excess > 0.0 else 1.0  # of the move
    friction = sense * resistance.friction
    near, near_excess = before, excess + friction
    far = high if sense > 0.0 else low
    far_excess = (
        compute_force_residual(answer, resistance, environment, far, before, time, dt) + friction
    )
    if sense * far_excess <= 0.0:
        return far
    kept = 0  # end kept in the last iteration (Illinois rule)
    for _ in range(MAX_ITERATIONS):
        new = near - near_excess * (far - near) / (far_excess - near_excess)
        if not min(near, far) < new < max(near, far):
            new = 0.5 * (near + far)
        excess = (
            compute_force_residual(answer, resistance, environment, new, before, time, dt)
            + friction
        )
        if abs(excess) <= FORCE_TOLERANCE or new in (near, far):
            return new
        if sense * excess < 0.0:
            near, near_excess = new, excess
            far_excess *= 0.5 if kept == 1 else 1.0
            kept = 1
        else:
            far, far_excess = new, excess
            near_excess *= 0.5 if kept == -1 else 1.0
            kept = -1
    return near
