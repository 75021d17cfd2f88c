"""Tendon control: from the commanded travel of a joint to motor positions.

`step` is the controller, `joint_estimate` estimates a joint from its tendons.
docs/explanation/estimator.md explains both.
"""

from slave.control.joint import (
    JointEstimate,
    compute_joint_offsets,
    compute_offset,
    estimate_joint,
    estimate_joints,
)
from slave.control.law import ControlConfig, ControllerState, step

__all__ = [
    "ControlConfig",
    "ControllerState",
    "JointEstimate",
    "compute_joint_offsets",
    "compute_offset",
    "estimate_joint",
    "estimate_joints",
    "step",
]
