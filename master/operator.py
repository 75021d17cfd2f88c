"""From the hand to the tips: where the operator wants them.

Motion is relative. Engaging couples the hand where it is to the tip where it is; from there

    tip = tip_anchor + position_scale * hand,    tip_anchor = tip - position_scale * hand

with tip and hand as they were when they were last coupled, so that neither engaging nor releasing
nor the clutch moves anything. The same holds, axis by axis, when the scale changes or a lock is
put on or taken off while they are coupled: the anchor is found anew from the tick before. Released,
the tip command stays where it was. A slave that was never commanded by this master starts at the
tip travel it reports, or at zero where it cannot tell.

With `align` hand and tip keep the one correspondence that they were first coupled with, but for
what the clutch changed on purpose: engaging waits until the hand is where the tip is.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from master.device import Axes, HandState
from teleop.config import MAY_BE_INFINITE
from teleop.messages import MAX_JOINTS, SlaveState
from teleop.session import Reason

_STILL: Axes = (0.0,) * MAX_JOINTS


@dataclass(frozen=True, slots=True)
class OperatorConfig:
    """How hand motion becomes tip motion. Axis k of the device moves joint k."""

    position_scale: float = 0.25  # tip travel per hand travel
    lock: tuple[int, ...] = ()  # axes, counted from 0, that move nothing
    align: float = field(  # [m] of the tip: engage only with the hand that close; inf = anywhere
        default=math.inf, metadata=MAY_BE_INFINITE
    )
    presence: float = field(  # [s] without the least motion: nobody holds the device; inf = trusted
        default=math.inf, metadata=MAY_BE_INFINITE
    )
    presence_motion: float = 20e-6  # [m] which a living hand does not keep within
    workspace: tuple[tuple[float, float], ...] = ()  # [m] of the hand, from ... to, one an axis
    wall: float = 300.0  # [N/m] stiffness of its limits, on the hand
    wall_damping: float = 2.0  # [N s/m] while the hand goes further in
    wall_max: float = 2.0  # [N] of a limit, on one axis
    weight: tuple[float, ...] = ()  # [N] that keeps the device's own weight, one an axis

    def __post_init__(self) -> None:
        """Refuse a scale that would reverse, freeze or explode the motion, and odd limits."""
        if not 0.0 < self.position_scale <= 10.0:
            raise ValueError("position_scale: must be above 0 and at most 10")
        if not all(0 <= axis < MAX_JOINTS for axis in self.lock):
            raise ValueError(f"lock: axes are counted from 0 to {MAX_JOINTS - 1}")
        if not self.align > 0.0:
            raise ValueError("align: must be above 0 [m]")
        if not self.presence >= 0.1:
            raise ValueError("presence: must be at least 0.1 [s]")
        if not 0.0 < self.presence_motion <= 0.01:
            raise ValueError("presence_motion: must be above 0 and at most 0.01 [m]")
        if not all(low < high for low, high in self.workspace):
            raise ValueError("workspace: pairs [from, to] in metres, from below to")
        for name, most, unit in (("wall", 2000, "N/m"), ("wall_damping", 20, "N s/m")):
            if not 0.0 <= getattr(self, name) <= most:
                raise ValueError(f"{name}: must be 0 to {most} [{unit}]")
        if not 0.0 <= self.wall_max <= 10.0:
            raise ValueError("wall_max: must be 0 to 10 [N]")
        if len(self.weight) > MAX_JOINTS or not all(abs(force) <= 10.0 for force in self.weight):
            raise ValueError("weight: one number an axis, at most 10 [N] each")


class Memory(NamedTuple):
    """What one tick hands to the next; positions have MAX_JOINTS entries, [m]."""

    tip: Axes = _STILL  # asked for last
    tip_anchor: Axes | None = None  # tip less scaled hand when the two were coupled; None = apart
    slave: int = 0  # sender nonce of the slave that `tip` was meant for
    hand: Axes = ()  # [m] that `tip` was found from; empty = never coupled to this slave
    scale: float = 0.0  # with it
    lock: tuple[int, ...] = ()


class TipCommand(NamedTuple):
    """Where the tips shall be, MAX_JOINTS entries."""

    position: Axes  # [m]
    velocity: Axes  # [m/s]


def step(
    config: OperatorConfig,
    memory: Memory,
    hand: HandState | None,
    state: SlaveState | None,
    engaged: bool,
) -> tuple[TipCommand, Memory]:
    """Return the tip command of one tick.

    Parameters
    ----------
    hand : HandState or None
        Newest read of the device, if it can be read.
    state : SlaveState or None
        Newest answer of the slave, if there ever was one.
    engaged : bool
        Whether the session couples hand and tip in this tick.
    """
    memory = _known(memory, state)
    if not engaged or hand is None:
        return TipCommand(memory.tip, _STILL), memory._replace(tip_anchor=None)
    scale, lock = config.position_scale, config.lock
    where = within(config, hand.position)
    tip, anchor = memory.tip, memory.tip_anchor
    if anchor is None:
        tip = _reported(tip, state) if math.isfinite(config.align) else tip
        anchor = tuple(t - scale * x for t, x in zip(tip, where, strict=False))
    elif (scale, lock) != (memory.scale, memory.lock):
        anchor = tuple(t - scale * x for t, x in zip(tip, memory.hand, strict=False))
    if lock:
        anchor = tuple(tip[k] - scale * x if k in lock else anchor[k] for k, x in enumerate(where))
    moved = tuple(
        tip[k] if k in lock else a + scale * x
        for k, (a, x) in enumerate(zip(anchor, where, strict=True))
    )
    velocity = tuple(
        0.0 if k in lock or where[k] != hand.position[k] else scale * v
        for k, v in enumerate(hand.velocity)
    )
    axes = len(where)
    command = TipCommand(moved + tip[axes:], velocity + _STILL[axes:])
    return command, Memory(command.position, anchor, memory.slave, where, scale, lock)


def hindrance(
    config: OperatorConfig, memory: Memory, hand: HandState | None, state: SlaveState | None
) -> Reason:
    """Return why hand and tip must not be coupled where they are, `Reason.NONE` if they may."""
    memory = _known(memory, state)
    if hand is None or not memory.hand or math.isinf(config.align):
        return Reason.NONE
    tip, where = _reported(memory.tip, state), within(config, hand.position)
    apart = (
        abs(asked + config.position_scale * (x - x0) - t)
        for k, (asked, x, x0, t) in enumerate(
            zip(memory.tip, where, memory.hand, tip, strict=False)
        )
        if k not in config.lock
    )
    return Reason.NONE if all(gap <= config.align for gap in apart) else Reason.ALIGN_FIRST


def within(config: OperatorConfig, position: Axes) -> Axes:
    """Return the hand's position [m], taken to the nearest point of its workspace."""
    if not config.workspace:
        return position
    limits = config.workspace
    return tuple(
        min(max(x, limits[k][0]), limits[k][1]) if k < len(limits) else x
        for k, x in enumerate(position)
    )


def _known(memory: Memory, state: SlaveState | None) -> Memory:
    """Return the memory, begun anew if another slave answers."""
    if state is None or state.sender == memory.slave:
        return memory
    return Memory(_reported(_STILL, state), None, state.sender)


def _reported(tip: Axes, state: SlaveState | None) -> Axes:
    """Return where the slave says its tips are [m]; `tip` where it cannot tell."""
    if state is None:
        return tip
    return tuple(p if math.isfinite(p) else t for p, t in zip(state.position, tip, strict=True))
