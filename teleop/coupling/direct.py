"""Direct position-force coupling, without passivity control.

For delays of a few milliseconds. The ledger is updated but not used.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal

from estimator.compiled import jit_compile
from teleop.coupling import energy_ledger
from teleop.coupling.energy_ledger import Port
from teleop.coupling.interface import MasterInput, SlaveInput, SlaveOutput, limit_travel


@dataclass(frozen=True, slots=True)
class DirectConfig:
    """No settings."""

    type: Literal["direct"] = "direct"

    reserve: ClassVar[float] = 0.0  # [J]


@jit_compile
def count_hand_work(port: Port, hand: MasterInput) -> None:
    """Count the work of the hand; see `teleop.coupling.interface`. The force is rendered as is."""
    work = hand.written * hand.travel
    energy_ledger.count_work(port, work)
    energy_ledger.pass_on_energy(port, work)


@jit_compile
def compute_tip_motion(port: Port, tip: SlaveInput) -> SlaveOutput:
    """Return the commanded motion unchanged; see `teleop.coupling.interface`."""
    travel = limit_travel(tip, tip.travel + tip.lag)
    work = -tip.force * travel
    energy_ledger.count_tip_work(port, work, False)
    energy_ledger.pass_on_energy(port, work)
    return SlaveOutput(travel, tip.velocity)
