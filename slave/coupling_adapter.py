"""The slave's port of the coupling: from where the tips are asked to be to where they shall go."""

import math
from collections.abc import Sequence

import numpy as np

from estimator.compiled import compiled
from estimator.records import as_record
from estimator.tendon_estimate import INVALID_INPUT
from slave.control.joint import JointEstimates
from slave.rig import Array
from teleop import coupling
from teleop.coupling import Bilateral, Side
from teleop.force_attenuation import ConfidenceConfig, attenuated
from teleop.messages import Command


@compiled
def rendered_forces(
    attenuation: ConfidenceConfig,
    joint_estimates: JointEstimates,
    joints: int,
    most: float,
    out_forces: Array,
) -> None:
    """Write the force of each joint as the hand feels it: the master works it out alike.

    Parameters
    ----------
    attenuation : ConfidenceConfig
        How an uncertain force is attenuated.
    joint_estimates : JointEstimates, shape (joints,) or longer
        What is known of each joint.
    joints : int
        How many there are.
    most : float
        The largest force that is rendered [N]; it comes from the master and may be any number.
    out_forces : array, shape (joints,) or longer
        [N], no more than `most`; zero for joints whose estimate is of a refused sample or not a
        number.
    """
    most = most if most > 0.0 else 0.0
    for k in range(joints):
        estimate, force = joint_estimates[k], 0.0
        if math.isfinite(estimate.force) and not estimate.status & INVALID_INPUT:
            force = attenuated(attenuation, estimate.force, estimate.low, estimate.high)
        out_forces[k] = min(max(force, -most), most)


def step(
    bilateral: Bilateral,
    side: Side,
    command: Command | None,
    asked: Sequence[float],
    speed: Sequence[float],
    estimates: JointEstimates,
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
    estimates : JointEstimates
        What is known of each joint, exactly one for each.
    coupled : bool
        Whether the tips follow.
    """
    if command is None:
        return tuple(asked), tuple(speed), side
    side = coupling.hear(side, command.sender, command.energy, command.wave)
    force = np.zeros(len(estimates))
    attenuation = as_record(bilateral.confidence)
    rendered_forces(attenuation, estimates, len(estimates), command.force_max, force)
    return coupling.at_tip(bilateral, side, asked, speed, tuple(force.tolist()), coupled, dt)
