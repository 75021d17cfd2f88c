"""What the PID firmwares have in common: a pool of effects, a clock, and a force that comes of it.

A firmware is a subclass that knows its bytes. Only constant force pushes; conditions (spring,
damper) are kept, not rendered: they act on the motion of a real stick, and there is none.
"""

import math
import struct
from dataclasses import dataclass, field
from typing import ClassVar

from studies.hid.virtual.device import Push, VirtualDevice

_CONSTANT = 1  # the first of the effect types in all descriptors known
_START_SOLO, _STOP = 2, 3
_LOADED, _FULL = 1, 2
INFINITE_MS = 0xFFFF
OUTPUTS = {  # of most firmwares, beside Set Effect: by number, method and length
    0x03: ("set_condition", 15),
    0x05: ("set_constant", 4),
    0x0A: ("operate_effect", 4),
    0x0B: ("free_block", 2),
    0x0C: ("control_device", 2),
    0x0D: ("set_device_gain", 2),
}


@dataclass
class Effect:
    """One slot of the pool."""

    kind: int  # as the device's own descriptor counts the types
    duration: float = math.inf  # [s] after a start
    gain: float = 1.0
    pull: tuple[float, ...] = (0.0, 0.0)  # what magnitude 1 does to each axis
    magnitude: float = 0.0  # share of full scale
    conditions: dict[int, bytes] = field(default_factory=dict)  # by axis, the report as it came
    started: float | None = None  # [s]

    def is_playing(self, now: float) -> bool:
        return self.started is not None and now - self.started < self.duration


class PidFirmware(VirtualDevice):
    """A force-feedback joystick; see `VirtualDevice`. Set `safety` and `powered` as you like."""

    outputs: ClassVar[dict[int, tuple[str, int]]]  # id -> method, length of the report
    creation: int  # id of Create New Effect
    loading: int  # id of Block Load
    pooling: int  # id of Pool
    slots: int
    full_scale: int  # of a constant force
    answers_state = True  # or only sends it when it changes

    def __init__(self, descriptor: bytes, axes: int = 2) -> None:
        super().__init__(descriptor, axes, forces=axes)
        self.now = -math.inf
        self.active = False  # whether the motors are on
        self.safety = self.powered = True  # the safety switch is closed, the motors have power
        self.gain = 1.0
        self.effects: dict[int, Effect] = {}  # the pool, by block number
        self.loaded = (0, 0)  # block and status of the last creation
        self._told = b""

    def build_inputs(self, now: float) -> list[bytes]:
        """Return the newest position, and the state if it changed; note a force that ran out."""
        self._move_on(now)
        state, self._told = self._told, self.build_state()
        return [self.build_report()] if self._told == state else [self._told, self.build_report()]

    def take_output(self, now: float, report: bytes) -> None:
        name, length = self.outputs.get(report[0], ("", -1)) if report else ("", -1)
        if len(report) != length:
            self.refused.append(report)
            return
        self._move_on(now)
        getattr(self, name)(report)
        self._move_on(now)

    def set_feature(self, now: float, report: bytes) -> None:
        if len(report) != 4 or report[0] != self.creation:
            self.refused.append(report)
            return
        self._move_on(now)
        block = next((n for n in range(1, self.slots + 1) if n not in self.effects), 0)
        if block:
            self.effects[block] = Effect(report[1])
        self.loaded = (block, _LOADED if block else _FULL)

    def get_feature(self, now: float, number: int) -> bytes | None:
        self._move_on(now)
        if number == self.loading:
            return struct.pack("<BBBH", number, *self.read_load(), self.slots - len(self.effects))
        if number == self.pooling:
            return struct.pack("<BHBB", number, self.slots, *self.read_pool())
        return None

    def get_input(self, _now: float, number: int) -> bytes | None:
        """Return the state, if this firmware can be asked for it."""
        state = self.build_state() if self.answers_state else b""
        return state if state[:1] == bytes((number,)) else None

    def compute_force(self, now: float) -> tuple[float, ...]:
        """Return what the motors do at `now`, shares of full scale."""
        total = [0.0] * len(self.axes)
        if self.active and self.powered and self.safety:
            for effect in self.effects.values():
                if effect.kind == _CONSTANT and effect.is_playing(now):
                    for axis in range(len(total)):
                        total[axis] += effect.pull[axis] * effect.magnitude * effect.gain
        return tuple(max(-1.0, min(1.0, self.gain * share)) + 0.0 for share in total)

    def build_report(self) -> bytes:
        raise NotImplementedError

    def build_state(self) -> bytes:
        """Return the PID State report; empty if the firmware sends none."""
        return b""

    def read_load(self) -> tuple[int, int]:
        """Return block and status of the last creation."""
        return self.loaded

    def read_pool(self) -> tuple[int, int]:
        """Return how many effects play at a time, and how memory is managed."""
        return self.slots, 1

    def set_constant(self, report: bytes) -> None:
        block, magnitude = struct.unpack_from("<Bh", report, 1)
        if (effect := self.effects.get(block)) is not None:
            effect.magnitude = magnitude / self.full_scale

    def set_condition(self, report: bytes) -> None:
        if (effect := self.effects.get(report[1])) is not None:
            effect.conditions[report[2] & 0x0F] = report

    def operate_effect(self, report: bytes) -> None:
        """Start or stop an effect; a start restarts its clock."""
        _, block, operation, _ = report
        if operation == _START_SOLO:
            self.stop_all()
        if (effect := self.effects.get(block)) is not None:
            effect.started = None if operation == _STOP else self.now

    def free_block(self, report: bytes) -> None:
        self.effects.pop(report[1], None)

    def stop_all(self) -> None:
        for effect in self.effects.values():
            effect.started = None

    def _move_on(self, now: float) -> None:
        self.now = now
        force = self.compute_force(now)
        if force != self.pushes[-1].force:
            self.pushes.append(Push(now, force))


def to_seconds(milliseconds: int) -> float:
    return math.inf if milliseconds == INFINITE_MS else milliseconds * 1e-3
