"""No coupling in between: the tip goes where the hand is, the hand feels what the tip feels.

Right where the delay is a few milliseconds. The ledger is counted, and nothing depends on it.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal

from estimator.compiled import compiled
from teleop.coupling import port as ledger
from teleop.coupling.interface import MasterInput, SlaveInput, SlaveOutput
from teleop.coupling.port import Port


@dataclass(frozen=True, slots=True)
class DirectConfig:
    """Nothing to set."""

    type: Literal["direct"] = "direct"

    reserve: ClassVar[float] = 0.0  # [J]


@compiled
def count_hand(port: Port, hand: MasterInput) -> None:
    """Count the work of the hand; see `teleop.coupling.interface`. The force is rendered as is."""
    work = hand.written * hand.travel
    ledger.count_work(port, work)
    ledger.pass_on(port, work)


@compiled
def at_tip(port: Port, tip: SlaveInput) -> SlaveOutput:
    """Return the motion as it was asked for; see `teleop.coupling.interface`."""
    travel = tip.travel + tip.lag
    work = -tip.force * travel
    ledger.count_tip_work(port, work, False)
    ledger.pass_on(port, work)
    return SlaveOutput(travel, tip.velocity)
