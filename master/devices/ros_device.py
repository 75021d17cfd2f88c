"""A ROS node as operator: the commands that its receiver process accepts, as a hand's motion.

Nothing is felt: forces are ignored. What is wrong with the commands is a lost device, with its
name, until the node sends `disable`.
"""

import json
import math
import os
import struct
import subprocess
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from typing import Literal, NamedTuple

from master.device import Axes, DeviceFault, DeviceLost, HandState
from teleop.messages.messages import MAX_JOINTS
from teleop.ros.message_types import MISSING_EXTRA
from teleop.runtime.child_process import end_process, start_module

# --- config of a ROS node as operator

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

        axes_max = MAX_JOINTS if self.command == "servo_jp" else TWIST_AXES
        if not 1 <= self.axes <= axes_max:
            raise ValueError(f"axes: must be within 1 ... {axes_max} for {self.command}")
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


# --- the motion of a hand that follows the commands. Pure: time is an argument
# Between two positions it moves linearly, within the time that lay between them, so that a node of
# 100 Hz moves the tip without steps. While the switch is open it is where the newest command is.
#
# A loop reads the newest record only, so it may miss that the switch was open in between: one read
# with an open switch lies between two engagements, at the new position.


# --- what the receiver of ROS commands tells the master's process: fixed-size records on a pipe

_TEXT_BYTES = 160
_LAYOUT = struct.Struct(f"<qqqq{_TEXT_BYTES}s{MAX_JOINTS}d")
SIZE = _LAYOUT.size  # below PIPE_BUF: written whole or not at all


class CommandRecord(NamedTuple):
    """State of the commands."""

    written_ns: int = 0  # monotonic
    received_ns: int = 0  # monotonic; 0 = no command yet
    number: int = 0  # count of accepted commands
    engagement: int = 0  # number of the present engagement; 0 = the switch is open
    fault: str = ""
    values: tuple[float, ...] = ()  # [m] or [m/s]

    def pack(self) -> bytes:
        """Return the bytes of the record."""
        text = self.fault.encode()[:_TEXT_BYTES].decode(errors="ignore").encode()
        values = (*self.values, *(0.0,) * (MAX_JOINTS - len(self.values)))
        head = self.written_ns, self.received_ns, self.number, self.engagement, text
        return _LAYOUT.pack(*head, *values)

    @classmethod
    def unpack(cls, data: bytes, axes: int) -> "CommandRecord":
        """Return the record of `SIZE` bytes."""
        written, received, number, engagement, text, *values = _LAYOUT.unpack(data)
        fault = text.rstrip(b"\0").decode()
        return cls(written, received, number, engagement, fault, tuple(values[:axes]))


_STEP_MAX_S = 0.01  # [s] of a velocity integrated over one tick


class CommandMotion:
    """State of the motion; see the module's text.

    Parameters
    ----------
    config : RosDeviceConfig
    """

    def __init__(self, config: RosDeviceConfig) -> None:
        self._config = config
        self._record = CommandRecord()
        self._position: Axes = (0.0,) * config.axes
        self._velocity: Axes = (0.0,) * config.axes
        self._from: Axes = self._position
        self._begin_s, self._span_s, self._time_s = 0.0, 0.0, 0.0

    def step(self, record: CommandRecord, is_fresh: bool, time_s: float) -> HandState:
        """Return the hand at `time_s` [s], by the newest record of the commands.

        Parameters
        ----------
        record : CommandRecord
        is_fresh : bool
            Whether its command came within the timeout.
        time_s : float
            [s] never decreasing.
        """
        previous, self._record = self._record, record
        dt, self._time_s = max(0.0, time_s - self._time_s), time_s
        engaged = 0 < record.engagement == previous.engagement
        if self._config.command == "servo_cv":
            self._integrate(record.values if engaged and is_fresh else (), dt)
        elif record.values:
            if not engaged:
                self._span_s = 0.0
            elif record.number != previous.number:
                passed_s = (record.received_ns - previous.received_ns) * 1e-9
                self._from, self._begin_s, self._span_s = self._position, time_s, passed_s
            self._move(record.values, time_s)
        else:
            self.rest()
        return HandState(self._position, self._velocity, engaged)

    def rest(self) -> HandState:
        """Return the hand where it is, at rest and with an open switch."""
        self._velocity = (0.0,) * len(self._position)
        return HandState(self._position, self._velocity, engage=False)

    def _move(self, target: Axes, time_s: float) -> None:
        """Move to a position, `_span_s` after `_begin_s`."""
        share = (time_s - self._begin_s) / self._span_s if self._span_s > 0.0 else 1.0
        if share >= 1.0:
            self._position = target
            self.rest()
            return
        pairs = tuple(zip(self._from, target, strict=True))
        self._position = tuple(a + (b - a) * share for a, b in pairs)
        self._velocity = tuple((b - a) / self._span_s for a, b in pairs)

    def _integrate(self, velocity: Axes, dt: float) -> None:
        """Move at a commanded velocity; not at all without one."""
        self._velocity = velocity or (0.0,) * len(self._position)
        step = min(dt, _STEP_MAX_S)
        self._position = tuple(
            x + v * step for x, v in zip(self._position, self._velocity, strict=True)
        )


RECORD_TIMEOUT_NS = 250_000_000  # [ns] without a record of the receiver
_READ_BYTES = 64 * SIZE


class RosDevice:
    """A `master.device.Device`; see the module's text.

    Parameters
    ----------
    config : RosDeviceConfig

    Raises
    ------
    DeviceFault
        `rosbags` is not installed, or the receiver process cannot be started.
    """

    def __init__(self, config: RosDeviceConfig) -> None:
        if find_spec("rosbags") is None:
            raise DeviceFault(MISSING_EXTRA)
        self.axes = config.axes
        self._config = config
        self._motion = CommandMotion(config)
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

        Raises
        ------
        DeviceLost
            A fault of the commands, or the receiver is stopped.
        DeviceFault
            The receiver has ended.
        """
        self._take()
        record, now_ns = self._record, time.monotonic_ns()
        if self._process.poll() is not None:
            raise DeviceFault("the receiver of ROS commands has ended")
        if not self._began:  # it is starting
            return self._motion.rest()
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
            self._motion.rest()
            raise DeviceLost(fault)
        return self._motion.step(record, age_ns <= self._config.timeout * 1e9, time_s)

    def write(self, force: Axes) -> None:
        """Check the force, which nobody feels."""
        if len(force) != self.axes or not all(map(math.isfinite, force)):
            raise DeviceFault(f"ROS device: refuses force {force}")

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
