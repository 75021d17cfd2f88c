"""Tendon control: from the commanded travel of a joint to motor positions.

`step` is the controller, `estimate_joints` estimates joints from their tendons.
docs/explanation/control.md explains both.
"""

from slave.control.joint_estimate import (
    JointEstimate,
    compute_offsets,
    estimate_joints,
)
from slave.control.tendon_control import ControlConfig, ControllerState, step

__all__ = [
    "ControlConfig",
    "ControllerState",
    "JointEstimate",
    "compute_offsets",
    "estimate_joints",
    "step",
]
