"""A ROS node as operator: the commands that its receiver process accepts, as a hand's motion.

Nothing is felt: forces are ignored. What is wrong with the commands is a lost device, with its
name, until the node sends `disable`.
"""

import json
import math
import os
import subprocess
import time
from contextlib import suppress
from dataclasses import asdict
from importlib.util import find_spec

from master.device import Axes, DeviceFault, DeviceLost, HandState
from master.devices.ros.config import RosDeviceConfig
from master.devices.ros.motion import SIZE, CommandMotion, CommandRecord
from teleop.ros.message_types import MISSING_EXTRA
from teleop.runtime.child_process import end_process, start_module

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
                "master.devices.ros.receiver",
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
        wrong = record.fault
        if now_ns - record.written_ns > RECORD_TIMEOUT_NS:
            wrong = "the receiver of ROS commands does not answer"
        elif (
            not wrong
            and record.engagement
            and age_ns > self._config.timeout * 1e9 + RECORD_TIMEOUT_NS
        ):
            wrong = f"ROS {self._config.command}: silent"
        if wrong:
            self._motion.rest()
            raise DeviceLost(wrong)
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
        whole = len(data) // SIZE * SIZE
        self._part = data[whole:]
        if whole:
            self._record = CommandRecord.unpack(data[whole - SIZE : whole], self.axes)
            self._began = True
