"""The slave's port of the coupling: from where the tips are asked to be to where they shall go."""

import math
from collections.abc import Sequence

from estimator import online
from slave.control import JointEstimate
from teleop import coupling
from teleop.confidence import ConfidenceConfig, attenuated
from teleop.coupling import Bilateral, Side
from teleop.messages import Command


def felt(
    confidence: ConfidenceConfig, estimates: Sequence[JointEstimate], most: float
) -> tuple[float, ...]:
    """Return the force of each joint [N] as the hand feels it: the master works it out alike.

    Zero for joints whose estimate is of a refused sample or no number; no more than the `most` that
    is rendered.
    """
    refused = online.Status.INVALID_INPUT
    forces = (
        attenuated(confidence, e.force, e.low, e.high)
        if math.isfinite(e.force) and not e.status & refused
        else 0.0
        for e in estimates
    )
    most = most if most > 0.0 else 0.0  # which may be anything: NaN too
    return tuple(min(max(force, -most), most) for force in forces)


def step(
    bilateral: Bilateral,
    side: Side,
    command: Command | None,
    asked: Sequence[float],
    speed: Sequence[float],
    estimates: Sequence[JointEstimate],
    coupled: bool,
    dt: float,
) -> tuple[tuple[float, ...], tuple[float, ...], Side]:
    """Return where the tips shall be [m] and go [m/s], and the new memory.

    Parameters
    ----------
    command : Command or None
        The newest, if one ever came.
    asked, speed : sequences of float
        What it asks of each joint [m], [m/s].
    estimates : sequence of JointEstimate
        What is known of each joint.
    coupled : bool
        Whether the tips follow.
    """
    if command is None:
        return tuple(asked), tuple(speed), side
    side = coupling.hear(side, command.sender, command.energy, command.wave)
    force = felt(bilateral.confidence, estimates, command.force_max)
    return coupling.at_tip(bilateral, side, asked, speed, force, coupled, dt)
