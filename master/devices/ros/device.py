"""A ROS node as operator: the commands that its receiver process accepts, as a hand's motion.

Between two commands the position moves linearly, within the time that lay between them, so that a
node of 100 Hz moves the tip without steps. Nothing is felt: forces are ignored. What is wrong with
the commands is a lost device, with its name, until the node sends `disable`.
"""

import json
import math
import os
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import asdict

from master.device import Axes, DeviceFault, DeviceLost, HandState
from master.devices.ros.config import RosDeviceConfig
from master.devices.ros.record import SIZE, CommandRecord

SILENT_NS = 250_000_000  # [ns] without a record of the receiver
_LONGEST_STEP_S = 0.01  # [s] of a velocity integrated over one tick
_READ_BYTES = 64 * SIZE


class RosDevice:
    """A `master.device.Device`; see the module's text.

    Parameters
    ----------
    config : RosDeviceConfig

    Raises
    ------
    DeviceFault
        The receiver process cannot be started.
    """

    def __init__(self, config: RosDeviceConfig) -> None:
        self.axes = config.axes
        self._config = config
        self._record = CommandRecord()
        self._part = b""
        self._began = False
        self._position: Axes = (0.0,) * config.axes
        self._velocity: Axes = (0.0,) * config.axes
        self._from: Axes = self._position
        self._begin_s, self._span_s, self._time_s = 0.0, 0.0, 0.0
        self._pipe, theirs = os.pipe()
        os.set_blocking(self._pipe, False)
        words = [sys.executable, "-m", "master.devices.ros.receiver", str(theirs)]
        try:
            self._process = subprocess.Popen(
                [*words, json.dumps(asdict(config)), str(os.getpid())],
                pass_fds=(theirs,),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                start_new_session=True,  # so that Ctrl-C does not reach it
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
        dt, self._time_s = max(0.0, time_s - self._time_s), time_s
        before = self._record
        self._take()
        record = self._record
        if self._process.poll() is not None:
            raise DeviceFault("the receiver of ROS commands has ended")
        if not self._began:  # it is starting
            return HandState(self._position, self._velocity, engage=False)
        if time.monotonic_ns() - record.written_ns > SILENT_NS:
            self._rest()
            raise DeviceLost("the receiver of ROS commands does not answer")
        if record.fault:
            self._rest()
            raise DeviceLost(record.fault)
        age_ns = time.monotonic_ns() - record.received_ns
        if record.engage and age_ns > self._config.timeout * 1e9 + SILENT_NS:
            self._rest()
            raise DeviceLost(f"ROS {self._config.command}: silent")
        if self._config.command == "servo_cv":
            fresh = age_ns <= self._config.timeout * 1e9
            self._integrate(record.values if fresh and record.engage else (), dt)
        elif record.number != before.number:
            self._aim(record, before, time_s)
        if self._config.command == "servo_jp":
            self._move(record, time_s)
        return HandState(self._position, self._velocity, record.engage)

    def write(self, force: Axes) -> None:
        """Check the force, which nobody feels."""
        if len(force) != self.axes or not all(map(math.isfinite, force)):
            raise DeviceFault(f"ROS device: refuses force {force}")

    def close(self) -> None:
        """End the receiver."""
        self._process.terminate()
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
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

    def _aim(self, record: CommandRecord, before: CommandRecord, time_s: float) -> None:
        """Begin to move to a new position, over the time between the last two commands."""
        passed_s = (record.received_ns - before.received_ns) * 1e-9
        if before.received_ns == 0 or passed_s > self._config.timeout:
            self._position = record.values  # a stream begins: nothing is coupled to it yet
            passed_s = 0.0
        self._from, self._begin_s, self._span_s = self._position, time_s, passed_s

    def _move(self, record: CommandRecord, time_s: float) -> None:
        if not record.values or record.number == 0:
            self._rest()
            return
        share = (time_s - self._begin_s) / self._span_s if self._span_s > 0.0 else 1.0
        if share >= 1.0:
            self._position = record.values
            self._rest()
            return
        pairs = tuple(zip(self._from, record.values, strict=True))
        self._position = tuple(a + (b - a) * share for a, b in pairs)
        self._velocity = tuple((b - a) / self._span_s for a, b in pairs)

    def _integrate(self, velocity: Axes, dt: float) -> None:
        """Move at a commanded velocity; not at all without one."""
        self._velocity = velocity or (0.0,) * self.axes
        step = min(dt, _LONGEST_STEP_S)
        self._position = tuple(
            x + v * step for x, v in zip(self._position, self._velocity, strict=True)
        )

    def _rest(self) -> None:
        self._velocity = (0.0,) * self.axes
