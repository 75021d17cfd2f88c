"""From the hand to the tips: where the operator wants them.

Motion is relative. Engaging couples the hand where it is to the tip where it is; from there

    tip = tip_at_engage + position_scale * (hand - hand_at_engage)

so that neither engaging nor releasing moves anything. Released, the tip command stays where it was.
A slave that was never commanded by this master starts at the tip travel it reports, or at zero
where it cannot tell.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from master.device import Axes, HandState
from teleop.messages import MAX_JOINTS, SlaveState

_STILL: Axes = (0.0,) * MAX_JOINTS


@dataclass(frozen=True, slots=True)
class OperatorConfig:
    """How hand motion becomes tip motion. Axis k of the device moves joint k."""

    position_scale: float = 0.25  # tip travel per hand travel

    def __post_init__(self) -> None:
        """Refuse a scale that would reverse, freeze or explode the motion."""
        if not 0.0 < self.position_scale <= 10.0:
            raise ValueError("position_scale: must be above 0 and at most 10")


class Memory(NamedTuple):
    """What one tick hands to the next; positions have MAX_JOINTS entries, [m]."""

    tip: Axes = _STILL  # asked for last
    tip_anchor: Axes | None = None  # tip less scaled hand when the two were coupled; None = apart
    slave: int = 0  # sender nonce of the slave that `tip` was meant for


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
    tip, anchor, slave = memory
    if state is not None and state.sender != slave:
        known = tuple(p if math.isfinite(p) else 0.0 for p in state.position)
        tip, anchor, slave = known, None, state.sender
    if not engaged or hand is None:
        return TipCommand(tip, _STILL), Memory(tip, None, slave)
    scale = config.position_scale
    scaled = tuple(scale * position for position in hand.position)
    if anchor is None:
        anchor = tuple(t - s for t, s in zip(tip, scaled, strict=False))
    unused = tip[len(scaled) :]
    tip = tuple(a + s for a, s in zip(anchor, scaled, strict=True)) + unused
    velocity = tuple(scale * v for v in hand.velocity) + _STILL[len(scaled) :]
    return TipCommand(tip, velocity), Memory(tip, anchor, slave)
