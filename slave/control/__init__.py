"""Tendon control: from the travel asked of a joint to the positions of the motors that pull it.

`step` is the controller, `joint_estimate` what is known of a joint from its tendons.
docs/control.md explains both.
"""

from slave.control.config import ControlConfig
from slave.control.joint import JointEstimate, TendonSeen, joint_estimate, offset, seen
from slave.control.law import Control, step

__all__ = [
    "Control",
    "ControlConfig",
    "JointEstimate",
    "TendonSeen",
    "joint_estimate",
    "offset",
    "seen",
    "step",
]
