"""How hand and tip are coupled over a network with delay, loss and jitter; docs/coupling.md.

`port` is the energy ledger, `sides` the interface, `direct`, `passivity` and `wave` are the
couplings, `side` is all joints of one side.
"""

from teleop.coupling.config import Bilateral, CouplingConfig
from teleop.coupling.direct import DirectConfig
from teleop.coupling.passivity import PassivityConfig
from teleop.coupling.side import (
    LEDGER_PERIOD_NS,
    Side,
    at_hand,
    at_tip,
    hear,
    ledger_message,
)
from teleop.coupling.wave import WaveConfig

__all__ = [
    "LEDGER_PERIOD_NS",
    "Bilateral",
    "CouplingConfig",
    "DirectConfig",
    "PassivityConfig",
    "Side",
    "WaveConfig",
    "at_hand",
    "at_tip",
    "hear",
    "ledger_message",
]
