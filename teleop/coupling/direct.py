"""No coupling in between: the tip goes where the hand is, the hand feels what the tip feels.

Right where the delay is a few milliseconds. The ledger is counted, and nothing hangs on it.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal

from teleop.coupling import port as ledger
from teleop.coupling.port import Port
from teleop.coupling.sides import Felt, Followed, Pulled, Rendered


@dataclass(frozen=True, slots=True)
class DirectConfig:
    """Nothing to set."""

    type: Literal["direct"] = "direct"

    reserve: ClassVar[float] = 0.0  # [J]


def at_hand(_config: DirectConfig, port: Port, felt: Felt, _dt: float) -> Rendered:
    """Return the force as it came; see `teleop.coupling.sides`."""
    work = felt.written * felt.way
    return Rendered(felt.force, ledger.pass_on(ledger.worked(port, work), work))


def at_tip(_config: DirectConfig, port: Port, pulled: Pulled, _dt: float) -> Followed:
    """Return the way as it was asked for; see `teleop.coupling.sides`."""
    way = pulled.way + pulled.lag
    work = -pulled.force * way
    counted = ledger.pass_on(ledger.returned(port, work, passive=False), work)
    return Followed(way, pulled.velocity, counted)
