"""Tendon control: from the commanded travel of a joint to motor positions.

`step` is the controller, `joint_estimate` estimates a joint from its tendons.
docs/control.md explains both.
"""

from slave.control.config import ControlConfig
from slave.control.joint import (
    JointEstimate,
    joint_estimate,
    joint_estimates,
    joint_offsets,
    offset,
)
from slave.control.law import Control, step

__all__ = [
    "Control",
    "ControlConfig",
    "JointEstimate",
    "joint_estimate",
    "joint_estimates",
    "joint_offsets",
    "offset",
    "step",
]
