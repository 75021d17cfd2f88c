"""The forces at the slave's port of the coupling, as rendered to the hand."""

import math

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.online.tendon_estimate import INVALID_INPUT
from slave.control.joint import JointEstimates
from teleop.coupling.force_attenuation import ConfidenceConfig, attenuate_force


@jit_compile
def compute_rendered_forces(
    attenuation: ConfidenceConfig,
    joint_estimates: JointEstimates,
    joints: int,
    most: float,
    out_forces: Array,
) -> None:
    """Write the rendered force of each joint; the master computes the same.

    Parameters
    ----------
    attenuation : ConfidenceConfig
        Attenuation of uncertain forces.
    joint_estimates : JointEstimates, shape (joints,) or longer
        Estimates of the joints.
    joints : int
        How many there are.
    most : float
        Largest rendered force [N]; sent by the master, may be any number.
    out_forces : array, shape (joints,) or longer
        [N], at most `most`; zero for joints whose estimate is invalid or not finite.
    """
    most = most if most > 0.0 else 0.0
    for k in range(joints):
        estimate, force = joint_estimates[k], 0.0
        if math.isfinite(estimate.force) and not estimate.status & INVALID_INPUT:
            force = attenuate_force(attenuation, estimate.force, estimate.low, estimate.high)
        out_forces[k] = min(max(force, -most), most)
