"""Map hand motion to tip commands.

Motion is relative. Engaging couples the hand where it is to the tip where it is; from there

    tip = tip_anchor + position_scale * hand,    tip_anchor = tip - position_scale * hand

with tip and hand as of the last coupling, so that engaging, releasing and the clutch do not move
the tip. The same holds, axis by axis, when scale or lock change while coupled: the anchor is
recomputed from the last tick. While released, the tip command is constant. For a slave not
commanded by this master before, it starts at the reported tip travel, or at zero if unknown.

With `align` hand and tip keep the anchor of the first coupling, except for clutching: engaging
requires the hand at the position of the tip.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.structs import F64, U64, Field, Flag, Struct, StructArray, view_struct
from master.hand_input import Axes, HandInput, fill_axes
from teleop.config.ranges import build_ranged_field, check_ranges
from teleop.messages.messages import MAX_JOINTS, SlaveState
from teleop.session.state_machine import Reason

# bytes: numba has no arrays of flags in records
LockFlags = Annotated[NDArray[np.uint8], Field("u1", MAX_JOINTS)]


@dataclass(frozen=True, slots=True)
class OperatorConfig:
    """How hand motion becomes tip motion. Axis k of the device moves joint k."""

    # tip travel per hand travel
    position_scale: float = build_ranged_field(0.25, 0.0, 10.0, above=True)
    # axes, counted from 0, that do not move their joint
    lock: tuple[int, ...] = build_ranged_field((), 0, MAX_JOINTS - 1)
    # of the tip: largest distance for engaging; inf = no check
    align: float = build_ranged_field(math.inf, 0.0, math.inf, "m", above=True)
    # without motion: no hand at the device; inf = no check
    presence: float = build_ranged_field(math.inf, 0.1, math.inf, "s")
    # motion threshold of that check
    presence_motion: float = build_ranged_field(20e-6, 0.0, 0.01, "m", above=True)
    workspace: tuple[tuple[float, float], ...] = ()  # [m], [rad] of the hand, [from, to] per axis
    # stiffness of the workspace limits, at the hand
    wall: float = build_ranged_field(300.0, 0.0, 2000.0, "N/m")
    wall_damping: float = build_ranged_field(2.0, 0.0, 20.0, "N s/m")  # damping of outward motion
    # largest force of a limit on one axis
    wall_max: float = build_ranged_field(2.0, 0.0, 10.0, "N")
    # [N], [N m] weight compensation of the device, per axis
    weight: tuple[float, ...] = build_ranged_field((), -10.0, 10.0)

    def __post_init__(self) -> None:
        check_ranges(self)
        if not all(low < high for low, high in self.workspace):
            raise ValueError("workspace: pairs [from, to] in metres, from below to")
        if len(self.weight) > MAX_JOINTS:
            raise ValueError("weight: one number an axis")


class OperatorSettings(Struct):
    """An `OperatorConfig` as a record: one entry for each axis in place of its tuples."""

    position_scale: F64
    lock: LockFlags
    align: F64
    presence: F64
    presence_motion: F64
    low: Axes  # [m] ends of the workspace: -inf and inf for an axis without limits
    high: Axes
    wall: F64
    wall_damping: F64
    wall_max: F64
    weight: Axes  # [N] zero for an axis without one


def build_operator_settings(config: OperatorConfig) -> StructArray:
    """Return the record of a config as an array of one."""
    records = OperatorSettings.array()
    settings: OperatorSettings = view_struct(records)
    for name in _SCALARS:
        setattr(settings, name, getattr(config, name))
    settings.low[:] = -math.inf
    settings.high[:] = math.inf
    for k, (low, high) in enumerate(config.workspace[:MAX_JOINTS]):
        settings.low[k] = low
        settings.high[k] = high
    settings.lock[list(config.lock)] = 1
    fill_axes(settings.weight, config.weight)
    return records


_SCALARS = (
    *("position_scale", "align", "presence", "presence_motion"),
    *("wall", "wall_damping", "wall_max"),
)


class OperatorMemory(Struct):
    """State between ticks."""

    tip: Axes  # [m] last command, all joints
    coupled: Flag = False  # hand and tip are coupled
    tip_anchor: Axes  # [m] tip less scaled hand at the last coupling
    slave: U64 = 0  # sender nonce of the commanded slave
    hand_known: Flag = False  # coupled to this slave at least once
    hand: Axes  # [m] at the last command
    scale: F64 = 0.0  # with it
    lock: LockFlags


@jit_compile
def step(
    settings: OperatorSettings,
    memory: OperatorMemory,
    hand: HandInput,
    state: SlaveState,
    has_state: bool,
    engaged: bool,
    out_position: Array,
    out_velocity: Array,
) -> None:
    """Compute the tip command of one tick.

    Parameters
    ----------
    hand : HandInput
        Newest read of the device.
    state : SlaveState
        Newest state of the slave; not read unless `has_state`.
    engaged : bool
        Whether the session couples hand and tip in this tick.
    out_position, out_velocity : arrays of shape (8,)
        Commanded tip travel [m] and velocity [m/s]; all joints.
    """
    _reset_for_other_slave(memory, state, has_state)
    coupled = engaged and hand.present
    if coupled:
        _update_anchors(settings, memory, hand, state, has_state)
    memory.coupled = coupled
    for k in range(MAX_JOINTS):
        out_velocity[k] = 0.0
        if coupled and k < hand.axes:
            x = clip_to_workspace(settings, k, hand.position[k])
            memory.hand[k] = x
            if not settings.lock[k]:
                memory.tip[k] = memory.tip_anchor[k] + settings.position_scale * x
                if x == hand.position[k]:
                    out_velocity[k] = settings.position_scale * hand.velocity[k]
        out_position[k] = memory.tip[k]


@jit_compile
def _update_anchors(
    settings: OperatorSettings,
    memory: OperatorMemory,
    hand: HandInput,
    state: SlaveState,
    has_state: bool,
) -> None:
    """Update the anchors: kept unless coupling, scale or locks have changed."""
    scale = settings.position_scale
    coupling = not memory.coupled
    changed = scale != memory.scale
    for k in range(MAX_JOINTS):
        changed = changed or settings.lock[k] != memory.lock[k]
        memory.lock[k] = settings.lock[k]
    if coupling and math.isfinite(settings.align):
        for k in range(MAX_JOINTS):
            memory.tip[k] = _get_reported_travel(memory.tip[k], state, has_state, k)
    for k in range(hand.axes):
        if coupling or settings.lock[k]:
            x = clip_to_workspace(settings, k, hand.position[k])
            memory.tip_anchor[k] = memory.tip[k] - scale * x
        elif changed:
            memory.tip_anchor[k] = memory.tip[k] - scale * memory.hand[k]
    memory.scale = scale
    memory.hand_known = True


@jit_compile
def find_not_ready_reason(
    settings: OperatorSettings,
    memory: OperatorMemory,
    hand: HandInput,
    state: SlaveState,
    has_state: bool,
) -> int:
    """Return why hand and tip must not be coupled now, `Reason.NONE` if they may."""
    if not hand.present or not memory.hand_known or math.isinf(settings.align):
        return Reason.NONE
    if has_state and state.sender != memory.slave:  # another slave, never coupled to
        return Reason.NONE
    for k in range(hand.axes):
        x = clip_to_workspace(settings, k, hand.position[k])
        tip = _get_reported_travel(memory.tip[k], state, has_state, k)
        distance = abs(memory.tip[k] + settings.position_scale * (x - memory.hand[k]) - tip)
        if not settings.lock[k] and not distance <= settings.align:
            return Reason.ALIGN_FIRST
    return Reason.NONE


@jit_compile
def clip_to_workspace(settings: OperatorSettings, axis: int, x: float) -> float:
    """Return a hand position on one axis [m], clipped to the workspace."""
    low: float = settings.low[axis]
    high: float = settings.high[axis]
    return min(max(x, low), high)


@jit_compile
def _reset_for_other_slave(memory: OperatorMemory, state: SlaveState, has_state: bool) -> None:
    """Reset if another slave answers."""
    if not has_state or state.sender == memory.slave:
        return
    memory.slave = state.sender
    memory.coupled = False
    memory.hand_known = False
    for k in range(MAX_JOINTS):
        memory.tip[k] = _get_reported_travel(0.0, state, has_state, k)


@jit_compile
def _get_reported_travel(tip: float, state: SlaveState, has_state: bool, joint: int) -> float:
    """Return the tip travel reported by the slave [m]; `tip` if unknown."""
    position: float = state.position[joint] if has_state else math.nan
    return position if math.isfinite(position) else tip
