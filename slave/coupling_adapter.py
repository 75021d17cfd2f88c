"""The forces at the slave's port of the coupling: what the hand feels of each joint."""

import math

from estimator.array_types import Array
from estimator.compiled import compiled
from estimator.online.tendon_estimate import INVALID_INPUT
from slave.control.joint import JointEstimates
from teleop.force_attenuation import ConfidenceConfig, attenuate


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
            force = attenuate(attenuation, estimate.force, estimate.low, estimate.high)
        out_forces[k] = min(max(force, -most), most)
