"""The rigs that a config can name: one line each here, one module each beside it."""

from collections.abc import Callable
from typing import Any

from slave.rig import Rig
from slave.rigs.replayed import ReplayedRig, ReplayedRigConfig
from slave.rigs.simulated import SimulatedRig, SimulatedRigConfig

RigConfig = SimulatedRigConfig | ReplayedRigConfig

_RIGS: dict[type[Any], Callable[[Any], Rig]] = {
    SimulatedRigConfig: SimulatedRig,
    ReplayedRigConfig: ReplayedRig,
}


def open_rig(config: RigConfig) -> Rig:
    """Open the rig that `config` describes."""
    return _RIGS[type(config)](config)
