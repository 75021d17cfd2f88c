"""Config of a ROS node as operator."""

import math
from dataclasses import dataclass
from typing import Literal

from teleop.messages.messages import MAX_JOINTS

TWIST_AXES = 3


@dataclass(frozen=True, slots=True)
class RosDeviceConfig:
    """A ROS node that sends motion in the place of a hand, without feeling a force."""

    type: Literal["ros"] = "ros"
    axes: int = 1  # joints of servo_jp; axes x, y, z of servo_cv
    command: Literal["servo_jp", "servo_cv"] = "servo_jp"  # positions, or velocities
    timeout: float = 0.1  # [s] of silence, or of delay, after which it is a fault
    position_max: float = 1.0  # [m] a position beyond is a fault
    speed_max: float = 0.5  # [m/s] a faster command is a fault
    rate_max: float = 2000.0  # [Hz] more messages are a fault
    domain: int = 0  # ROS_DOMAIN_ID, as in the section `ros`
    router: str = "tcp/127.0.0.1:7447"  # likewise
    prefix: str = ""  # likewise

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        # here, as the network's packages are slow to load, and no other device needs them
        from teleop.ros.config import DOMAIN_MAX, check_router
        from teleop.ros.graph import is_name

        most = MAX_JOINTS if self.command == "servo_jp" else TWIST_AXES
        if not 1 <= self.axes <= most:
            raise ValueError(f"axes: must be within 1 ... {most} for {self.command}")
        if not 0.005 <= self.timeout <= 1.0:
            raise ValueError("timeout: must be within 0.005 ... 1 [s]")
        for name, unit in (("position_max", "m"), ("speed_max", "m/s")):
            if not 0.0 < getattr(self, name) <= 10.0 or math.isnan(getattr(self, name)):
                raise ValueError(f"{name}: must be above 0 and at most 10 [{unit}]")
        if not 10.0 <= self.rate_max <= 10_000.0:
            raise ValueError("rate_max: must be within 10 ... 10000 [Hz]")
        if not 0 <= self.domain <= DOMAIN_MAX:
            raise ValueError(f"domain: must be 0 to {DOMAIN_MAX}")
        check_router(self.router)
        if self.prefix and not is_name(self.prefix):
            raise ValueError("prefix: must be empty or a name such as /lab")

    @property
    def axis_count(self) -> int:
        """How many joints it moves."""
        return self.axes
