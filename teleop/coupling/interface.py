"""Interface of a coupling at a tick of either side, for one joint, in tip units.

    count_hand_work(config, port, MasterInput, dt)         adds the work of the hand
    render_force(config, port, MasterInput, force, dt)     the force for a motion
    compute_tip_motion(config, port, SlaveInput, dt)       the motion against a force

The master's tick has two phases: the work of the hand is added to the ledger and sent before the
tip's newest force is known; the force is computed afterwards from the same `MasterInput`. All
functions are compiled and update the port in place. Unused arguments are omitted.

Forces [N] are positive against pulling, travels [m] in the pulling direction.
"""

from typing import NamedTuple

from estimator.compiled import jit_compile
from estimator.structs import F64, Struct


class MasterInput(Struct):
    """The hand at the master's port, at a tick."""

    written: F64 = 0.0  # [N] rendered since the last tick
    travel: F64 = 0.0  # [m] of the hand since then
    velocity: F64 = 0.0  # [m/s] of the hand
    lever: F64 = 0.0  # stiffness at the hand for a stiffness at the tip: the product of the scales
    dragged: F64 = 0.0  # [m^2/s] times a damping at the hand [N s/m]: dissipated energy [J]


class SlaveInput(NamedTuple):
    """The tip at the slave's port, at a tick."""

    force: float  # [N] on the tip
    travel: float  # [m] commanded since the last tick
    lag: float  # [m] lag behind the command, at the last tick
    velocity: float  # [m/s] commanded
    travel_max: float  # [m] largest of this tick; may be infinite


class SlaveOutput(NamedTuple):
    """Motion of the tip."""

    travel: float  # [m]
    velocity: float  # [m/s]


@jit_compile
def limit_travel(tip: SlaveInput, travel: float) -> float:
    """Return `travel` [m] limited to the largest of this tick."""
    return min(max(travel, -tip.travel_max), tip.travel_max)
