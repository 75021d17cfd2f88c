"""A ROS node as operator: the commands that its receiver process accepts, as a hand's motion.

Nothing is felt: forces are ignored. What is wrong with the commands is a lost device, with its
name, until the node sends `disable`.
"""

import json
import os
import subprocess
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from typing import Literal

from master.device import Axes, DeviceFault, DeviceLost, HandState, require_force
from master.devices.commands import SIZE, CommandMotion, CommandRecord
from teleop.config.ranges import build_ranged_field, check_ranges
from teleop.messages.messages import MAX_JOINTS
from teleop.ros.message_types import MISSING_EXTRA
from teleop.runtime.child_process import end_process, start_module

# --- config of a ROS node as operator

TWIST_AXES, POSE_AXES = 3, 6


@dataclass(frozen=True, slots=True)
class RosDeviceConfig:
    """A ROS node that sends motion in the place of a hand, without feeling a force."""

    type: Literal["ros"] = "ros"
    # joints of servo_jp; x, y, z of servo_cv; of servo_cp also roll, pitch, yaw [rad]: 3 or 6
    axes: int = 1
    # positions, velocities, or the pose of a hand (master.mapping of type space)
    command: Literal["servo_jp", "servo_cv", "servo_cp"] = "servo_jp"
    # of silence, or of delay, after which it is a fault
    timeout: float = build_ranged_field(0.1, 0.005, 1.0, "s")
    # a position beyond is a fault
    position_max: float = build_ranged_field(1.0, 0.0, 10.0, "m", above=True)
    # a faster command is a fault
    speed_max: float = build_ranged_field(0.5, 0.0, 10.0, "m/s", above=True)
    # a faster turn of a pose is a fault
    turn_speed_max: float = build_ranged_field(5.0, 0.0, 10.0, "rad/s", above=True)
    rate_max: float = build_ranged_field(2000.0, 10.0, 10_000.0, "Hz")  # more messages are a fault
    domain: int = 0  # ROS_DOMAIN_ID, as in the section `ros`
    router: str = "tcp/127.0.0.1:7447"  # of rmw_zenoh, as in the section `ros`
    prefix: str = ""  # before the names of topics, as in the section `ros`

    def __post_init__(self) -> None:
        check_ranges(self)
        # here, as the network's packages are slow to load, and no other device needs them
        from teleop.ros.config import DOMAIN_MAX, check_router
        from teleop.ros.graph import is_name

        if self.command == "servo_cp":
            if self.axes not in (TWIST_AXES, POSE_AXES):
                raise ValueError(f"axes: must be {TWIST_AXES} or {POSE_AXES} for servo_cp")
        else:
            axes_max = MAX_JOINTS if self.command == "servo_jp" else TWIST_AXES
            if not 1 <= self.axes <= axes_max:
                raise ValueError(f"axes: must be 1 to {axes_max} for {self.command}")
        if not 0 <= self.domain <= DOMAIN_MAX:
            raise ValueError(f"domain: must be 0 to {DOMAIN_MAX}")
        check_router(self.router)
        if self.prefix and not is_name(self.prefix):
            raise ValueError("prefix: must be empty or a name such as /lab")

    @property
    def axis_count(self) -> int:
        """How many joints it moves."""
        return self.axes


RECORD_TIMEOUT_NS = 250_000_000  # [ns] without a record of the receiver
_READ_BYTES = 64 * SIZE


class RosDevice:
    """A `master.device.Device`; see the module's text.

    `DeviceFault` if `rosbags` is not installed, or the receiver process cannot be started.
    """

    def __init__(self, config: RosDeviceConfig) -> None:
        if find_spec("rosbags") is None:
            raise DeviceFault(MISSING_EXTRA)
        self.axes = config.axes
        self._config = config
        self._motion = CommandMotion(config.axes, is_velocity=config.command == "servo_cv")
        self._record = CommandRecord()
        self._part = b""
        self._began = False
        self._pipe, theirs = os.pipe()
        os.set_blocking(self._pipe, False)
        try:
            self._process = start_module(
                "master.devices.ros_receiver",
                *(str(theirs), json.dumps(asdict(config)), str(os.getpid())),
                pass_fds=(theirs,),
                stdout=subprocess.DEVNULL,
            )
        except OSError as error:
            os.close(self._pipe)
            raise DeviceFault(f"the receiver of ROS commands: {error}") from error
        finally:
            os.close(theirs)

    def read(self, time_s: float) -> HandState:
        """Return the motion commanded at `time_s`.

        `DeviceLost` by a fault of the commands, or if the receiver is stopped; `DeviceFault` if it
        has ended.
        """
        self._take()
        record, now_ns = self._record, time.monotonic_ns()
        if self._process.poll() is not None:
            raise DeviceFault("the receiver of ROS commands has ended")
        if not self._began:  # it is starting: the empty record is a hand at rest
            return self._motion.step(record, False, time_s)
        age_ns = now_ns - record.received_ns
        fault = record.fault
        if now_ns - record.written_ns > RECORD_TIMEOUT_NS:
            fault = "the receiver of ROS commands does not answer"
        elif (
            not fault
            and record.engagement
            and age_ns > self._config.timeout * 1e9 + RECORD_TIMEOUT_NS
        ):
            fault = f"ROS {self._config.command}: silent"
        if fault:
            self._motion.stop_hand()
            raise DeviceLost(fault)
        return self._motion.step(record, age_ns <= self._config.timeout * 1e9, time_s)

    def write(self, force: Axes) -> None:
        """Check the force, which nobody feels."""
        require_force(force, self.axes)

    def close(self) -> None:
        """End the receiver."""
        end_process(self._process, 2.0)
        os.close(self._pipe)

    def _take(self) -> None:
        """Take the newest record, if there is one."""
        data = self._part
        with suppress(BlockingIOError):
            data += os.read(self._pipe, _READ_BYTES)
        complete = len(data) // SIZE * SIZE
        self._part = data[complete:]
        if complete:
            self._record = CommandRecord.unpack(data[complete - SIZE : complete], self.axes)
            self._began = True
