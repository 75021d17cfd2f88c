"""Bilateral coupling of hand and tip over a network with delay, loss and jitter.

See docs/explanation/coupling.md.
`energy_ledger` is that of a port, `interface` the inputs and outputs of a coupling, `direct`,
`passivity` and `wave` are the couplings, `extension` those of other packages, `contact` is the
local model of what a tip meets, `side` is all joints of one side.
"""

from teleop.coupling.config import (
    Bilateral,
    BilateralSettings,
    CouplingConfig,
    has_settings_mismatch,
    to_bilateral_settings,
)
from teleop.coupling.direct import DirectConfig
from teleop.coupling.energy_ledger import LEDGER_PERIOD_NS, LedgerPublisher
from teleop.coupling.extension import CouplingExtension
from teleop.coupling.passivity import PassivityConfig
from teleop.coupling.side import (
    Side,
    compute_tip_motion,
    count_hand_work,
    receive_totals,
    render_force,
    update_contact_models,
)
from teleop.coupling.wave import WaveConfig

__all__ = [
    "LEDGER_PERIOD_NS",
    "Bilateral",
    "BilateralSettings",
    "CouplingConfig",
    "CouplingExtension",
    "DirectConfig",
    "LedgerPublisher",
    "PassivityConfig",
    "Side",
    "WaveConfig",
    "compute_tip_motion",
    "count_hand_work",
    "has_settings_mismatch",
    "receive_totals",
    "render_force",
    "to_bilateral_settings",
    "update_contact_models",
]
