"""Bilateral coupling of hand and tip over a network with delay, loss and jitter; docs/coupling.md.

`ledger` is the energy ledger of a port, `interface` the inputs and outputs of a coupling, `direct`,
`passivity` and `wave` are the couplings, `contact` is the local model of what a tip meets, `side`
is all joints of one side.
"""

from teleop.coupling.config import (
    Bilateral,
    BilateralSettings,
    CouplingConfig,
    bilateral_settings,
    differs,
)
from teleop.coupling.direct import DirectConfig
from teleop.coupling.ledger_publisher import LEDGER_PERIOD_NS, LedgerPublisher
from teleop.coupling.passivity import PassivityConfig
from teleop.coupling.side import (
    Side,
    at_tip,
    count_hand,
    observe,
    receive,
    render,
)
from teleop.coupling.wave import WaveConfig

__all__ = [
    "LEDGER_PERIOD_NS",
    "Bilateral",
    "BilateralSettings",
    "CouplingConfig",
    "DirectConfig",
    "LedgerPublisher",
    "PassivityConfig",
    "Side",
    "WaveConfig",
    "at_tip",
    "bilateral_settings",
    "count_hand",
    "differs",
    "observe",
    "receive",
    "render",
]
