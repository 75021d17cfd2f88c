"""Tendon control: from the travel asked of a joint to the positions of the motors that pull it.

`step` is the controller, `joint_estimate` what is known of a joint from its tendons.
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
