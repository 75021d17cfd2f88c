"""What a coupling is given at a tick of either side, and what it returns: one joint, tip units.

    count_hand(config, port, MasterInput, dt)              counts what the hand did
    render(config, port, MasterInput, force, dt) -> force  the force for a motion
    at_tip(config, port, SlaveInput, dt) -> SlaveOutput    the motion against a force

The master's tick has two phases. What the hand did is counted, and can be told, before the tip's
newest force is known; the force is worked out afterwards, from the same `MasterInput`. All of them
are compiled, and change the port in place. Arguments that a coupling does not need it leaves out.

Forces [N] are positive against pulling, travels [m] where they pull.
"""

from typing import NamedTuple

from estimator.records import F64, Record


class MasterInput(Record):
    """The hand at the master's port, at a tick."""

    written: F64 = 0.0  # [N] that was rendered since the last tick
    travel: F64 = 0.0  # [m] that the hand went since then
    velocity: F64 = 0.0  # [m/s] at which it goes on
    dragged: F64 = 0.0  # [m^2/s] times a damping at the hand [N s/m]: what that dissipated [J]


class SlaveInput(NamedTuple):
    """The tip at the slave's port, at a tick."""

    force: float  # [N] on the tip
    travel: float  # [m] that it was asked to go since the last tick
    lag: float  # [m] by which it was behind what was asked, then
    velocity: float  # [m/s] at which it is asked to go on


class SlaveOutput(NamedTuple):
    """Where the tip shall go."""

    travel: float  # [m]
    velocity: float  # [m/s]
