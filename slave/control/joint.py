"""What is known of a joint from the one or two tendons that move it.

A joint's travel q [m] is positive where its first tendon, `a`, pulls it; the tip of a second one,
`b`, travels by -q. Each tendon tells the joint's travel, q_p less its elongation, and each is
wrong by an error that grows with its elongation: the loose tendon, which has hardly any, is the
better sensor of the two as long as it is taut.
"""

from collections.abc import Sequence
from math import nan
from typing import NamedTuple

from estimator.online import Status, TendonEstimate
from slave.rig import RigSample

SIGNS = (1.0, -1.0)  # of the joint's travel in that of tendons a and b

SLACK = 0.05  # [N] at the housing: below, a tendon tells nothing of its joint
TAUT = 0.15  # [N] from here on it counts in full
_INVALID = int(Status.INVALID_INPUT)

FLOOR = 1e-5  # [m] added to an elongation before it weighs: no tendon is a perfect sensor


class TendonSeen(NamedTuple):
    """One tendon, measured and estimated."""

    tension: float  # [N] measured at the housing
    displacement: float  # [m] measured motor position; NaN without an encoder
    elongation: float  # [m] estimated
    valid: bool  # whether the estimator took the sample
    estimate: TendonEstimate


class JointEstimate(NamedTuple):
    """One joint at one instant."""

    position: float  # [m] travel, up to a constant; NaN without encoders
    force: float  # [N] of the environment on the tendons, positive against pulling by `a`
    low: float  # [N] ends of the interval that is certain for the force
    high: float  # [N]
    status: int  # bits of estimator.online.Status, of all its tendons


def seen(sample: RigSample, estimates: Sequence[TendonEstimate]) -> tuple[TendonSeen, ...]:
    """Return the tendons of a sample with their estimates."""
    tension = sample.proximal_tension.tolist()
    travel = sample.proximal_displacement
    displacement = [nan] * len(tension) if travel is None else travel.tolist()
    return tuple(
        TendonSeen(T, q, estimate.elongation, not int(estimate.status) & _INVALID, estimate)
        for T, q, estimate in zip(tension, displacement, estimates, strict=True)
    )


def fused(travels: Sequence[float], tendons: Sequence[TendonSeen]) -> float:
    """Return a joint's travel [m] from what each of its tendons tells.

    The weight of a tendon is 1/e^2, less where it is nearly slack, none where its estimate is
    invalid; with no weight left they count alike.
    """
    if len(travels) == 1:
        return travels[0]
    of_a, of_b = weight(tendons[0]), weight(tendons[1])
    if of_a == of_b:
        return 0.5 * (travels[0] + travels[1])
    if of_a == 0.0 or of_b == 0.0:
        return travels[0] if of_b == 0.0 else travels[1]
    return (of_a * travels[0] + of_b * travels[1]) / (of_a + of_b)


def weight(tendon: TendonSeen) -> float:
    """Return how much a tendon counts when its joint's travel is told [1/m^2]."""
    if not (tendon.valid and tendon.tension > SLACK):
        return 0.0
    error = FLOOR + max(tendon.elongation, 0.0)
    return min((tendon.tension - SLACK) / (TAUT - SLACK), 1.0) / (error * error)


def offset(tendons: Sequence[TendonSeen]) -> float:
    """Return by how much each tendon of a joint tells too much travel [m], taken symmetric.

    The travels q_p - e of both tips cancel but for a constant; this is half of it, as it is now.
    """
    if len(tendons) == 1:
        return 0.0
    return 0.5 * sum(tendon.estimate.distal_displacement for tendon in tendons)


def joint_estimate(tendons: Sequence[TendonSeen], offset: float = 0.0) -> JointEstimate:
    """Return what is known of a joint.

    The force is T_out,a - T_out,b, between low_a - high_b and high_a - low_b.

    Parameters
    ----------
    tendons : sequence of TendonSeen
        Its own, `a` first.
    offset : float
        Of its tendons [m], `offset` at an earlier time: that at which its position is right.
    """
    travels = [
        sign * (tendon.estimate.distal_displacement - offset)
        for sign, tendon in zip(SIGNS, tendons, strict=False)
    ]
    a = tendons[0].estimate
    force, low, high, status = a.distal_tension, a.low, a.high, int(a.status)
    if len(tendons) > 1:
        b = tendons[1].estimate
        force, low, high = force - b.distal_tension, low - b.high, high - b.low
        status |= int(b.status)
    return JointEstimate(fused(travels, tendons), force, low, high, status)
