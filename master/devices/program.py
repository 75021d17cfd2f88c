"""A program as operator: `teleop.Session` moves the hand from Python.

Program and master's process share a pair of sockets: the program sends where the hand is, at any
rate, and gets the rendered force with each answer. Nobody else can reach it. The hand rests where
the newest command left it; a program that is silent for `timeout` lets go of the switch.
"""

import math
import os
import select
import socket
import struct
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from master.device import Axes, DeviceFault, DeviceLost, HandState, require_force
from master.devices.commands import SIZE, CommandMotion, CommandRecord
from teleop.config.ranges import RangedConfig, build_ranged_field
from teleop.errors import TeleopError, UsageError
from teleop.messages.messages import MAX_JOINTS

SOCKET_VARIABLE = "TELEOP_OPERATOR_SOCKET"  # file descriptor of the master's end
POSITION_MAX = 1.0  # [m] a position beyond is refused
BUTTON_MAX = 128
_SPAN_MAX_S = 0.1  # [s] longest motion to the next position; a program of 10 Hz moves without steps
_RECORDS_PER_TICK = 32
_MASTER_ENDED = "operator: the master's process has ended"
_LAPSE_SHARE = 0.9  # of the timeout
_FORCES = struct.Struct(f"<{MAX_JOINTS}d")


@dataclass(frozen=True, slots=True)
class ProgramConfig(RangedConfig):
    """A program that moves the hand: `teleop.Session(..., operator=True)`."""

    type: Literal["program"] = "program"
    axes: int = build_ranged_field(1, 1, MAX_JOINTS)  # of the hand; each moves a joint
    # of silence after which the engage switch opens
    timeout: float = build_ranged_field(1.0, 0.01, 60.0, "s")

    @property
    def axis_count(self) -> int:
        """How many joints it moves."""
        return self.axes


class ProgramDevice:
    """The master's end: a `master.device.Device`; see the module's text.

    `DeviceFault` if this process was not started by `teleop.Session`.
    """

    def __init__(self, config: ProgramConfig) -> None:
        descriptor = os.environ.get(SOCKET_VARIABLE)
        if descriptor is None:
            raise DeviceFault("type program is for teleop.Session, which moves the hand; no other")
        self.axes = config.axes
        self._timeout_ns = round(config.timeout * 1e9)
        self._motion = CommandMotion(config.axes, span_max_s=_SPAN_MAX_S)
        self._record = CommandRecord()
        self._pressed: tuple[int, ...] = ()  # buttons, since the last read
        self._lapsed = 0  # the engagement that silence has ended
        self._wants_force = False
        self._socket = socket.socket(fileno=int(descriptor))
        self._socket.setblocking(False)

    def read(self, time_s: float) -> HandState:
        """Return the hand at `time_s`; `DeviceLost` if the program has ended."""
        self._receive()
        record = self._record
        if not all(map(math.isfinite, record.values)):
            raise DeviceLost(f"the program sent the position {record.values}")
        if time.monotonic_ns() - record.received_ns > self._timeout_ns:
            self._lapsed = record.engagement
        if record.engagement == self._lapsed:
            record = record._replace(engagement=0)
        hand = self._motion.step(record, True, time_s)
        if self._pressed:
            hand, self._pressed = replace(hand, buttons=self._pressed), ()
        return hand

    def write(self, force: Axes) -> None:
        """Send the force with the answer to the newest command."""
        require_force(force, self.axes)
        if self._wants_force:
            self._wants_force = False
            with suppress(OSError):  # a program that does not read, or has ended: `read` tells
                self._socket.send(_FORCES.pack(*force, *(0.0,) * (MAX_JOINTS - len(force))))

    def close(self) -> None:
        """Close this end."""
        self._socket.close()

    def _receive(self) -> None:
        """Take the newest command; of a flood some, so that a tick takes no longer for it."""
        for _ in range(_RECORDS_PER_TICK):
            try:
                data = self._socket.recv(SIZE)
            except BlockingIOError:
                return
            except ConnectionError:
                data = b""
            if not data:
                raise DeviceLost("the program that moves the hand has ended")
            self._record = CommandRecord.unpack(data, self.axes)
            if self._record.button:
                self._pressed += (self._record.button,)
            self._wants_force = True


class ProgramOperator:
    """The program's end: the hand of a session, moved from Python.

    Thread-safe as far as one call after another is.

    Parameters
    ----------
    config : ProgramConfig
        Of the device in the master's process.

    Attributes
    ----------
    axes : int
        Number of axes, one per joint.
    position : tuple of float
        Where the hand is [m], by the last `move`.
    """

    def __init__(self, config: ProgramConfig) -> None:
        self.axes = config.axes
        self.position: Axes = (0.0,) * config.axes
        self._timeout_s = config.timeout
        self._engagement = self._number = 0
        self._is_engaged = False
        self._sent_s = -math.inf
        self._force: Axes = (0.0,) * config.axes
        self._socket, self.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.setblocking(False)
        self._room = select.poll()
        self._room.register(self._socket, select.POLLOUT)

    def engage(self) -> None:
        """Open the engage switch and close it again.

        The session engages if it is ready (`Session.wait_for`), and stays engaged for as long as
        `move` or this is called again within `timeout`.
        """
        self._engagement += 1
        self._is_engaged = True
        self._send()

    def release(self) -> None:
        """Open the engage switch: the tip stays where it is, and no force is rendered."""
        self._is_engaged = False
        self._send()

    def move(self, position: float | Sequence[float]) -> None:
        """Move the hand; takes some microseconds, at any rate.

        The motion of the tip is relative to where hand and tip were when the session engaged. The
        hand moves linearly, within the time since the last call but at most 0.1 s.

        Parameters
        ----------
        position : float or sequence of float, shape (axes,)
            [m] of the hand; at most 1 m from zero.

        Raises
        ------
        UsageError
            A position is not finite or too far, or there are too few or too many.
        TeleopError
            The switch is open because nothing was sent for longer than `timeout`: engage again.
            Or the session has ended.
        """
        values = np.atleast_1d(np.asarray(position, float)).tolist()
        if len(values) != self.axes:
            raise UsageError(
                f"operator.move: {len(values)} numbers, must be {self.axes}, one an axis"
            )
        if not all(abs(value) <= POSITION_MAX for value in values):
            raise UsageError(
                f"operator.move: {values}: must be finite and within +-{POSITION_MAX:g} m"
            )
        if self._is_engaged and self._has_lapsed:
            self._is_engaged = False
            raise TeleopError(
                f"operator: nothing was sent for more than {self._timeout_s:g} s, so the hand has "
                "let go; call operator.engage() again (master.device.timeout)"
            )
        self.position = tuple(values)
        self._send()

    def press(self, button: int) -> None:
        """Press a button of the hand that has no function, for a moment.

        Parameters
        ----------
        button : int
            Its number, 1 to `BUTTON_MAX`. The master makes the event "button 2 pressed" of it.

        Raises
        ------
        UsageError
            There is no such button.
        """
        if button not in range(1, BUTTON_MAX + 1):
            raise UsageError(f"operator.press: button {button}: must be 1 to {BUTTON_MAX}")
        self._send(button)

    @property
    def force(self) -> Axes:
        """Force on the hand [N], one per axis, when the newest command was taken.

        `TeleopError` once the master's process has ended.
        """
        self._receive()
        return self._force

    def leave_master_end(self) -> None:
        """Close the master's end here, once its process has it: its end is noticed then."""
        self.theirs.close()

    def close(self) -> None:
        """Close both ends here; the master's process has its own."""
        self._socket.close()
        self.theirs.close()

    @property
    def _has_lapsed(self) -> bool:
        # earlier than the master's process finds it, so that no motion is lost without a word
        return time.monotonic() - self._sent_s > _LAPSE_SHARE * self._timeout_s

    def _send(self, button: int = 0) -> None:
        self._sent_s = time.monotonic()
        self._number += 1
        now_ns = time.monotonic_ns()
        engagement = self._engagement if self._is_engaged else 0
        record = CommandRecord(now_ns, now_ns, self._number, engagement, "", self.position, button)
        data = record.pack()
        self._receive()  # so that the newest force has room
        # the master takes some commands a tick; nothing is lost in a full queue
        if not self._room.poll(1e3 * self._timeout_s):
            raise TeleopError("operator: the master's process takes no commands")
        try:
            self._socket.send(data)
        except OSError as error:
            raise TeleopError(_MASTER_ENDED) from error

    def _receive(self) -> None:
        """Take the forces that have come."""
        try:
            while data := self._socket.recv(_FORCES.size):
                self._force = _FORCES.unpack(data)[: self.axes]
        except BlockingIOError:
            return
        except OSError as error:
            raise TeleopError(_MASTER_ENDED) from error
        raise TeleopError(_MASTER_ENDED)
