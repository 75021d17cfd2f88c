"""What a coupling is asked at a tick of either side, and what it answers: one joint, tip units.

    at_hand(config, port, Felt, dt) -> Rendered      the force for a motion
    at_tip(config, port, Pulled, dt) -> Followed     the motion against a force

Forces [N] are positive against pulling, ways [m] where they pull.
"""

from typing import NamedTuple

from teleop.coupling.port import Port


class Felt(NamedTuple):
    """The master's port at a tick."""

    force: float  # [N] that the tip feels, as told
    written: float  # [N] that was rendered since the last tick
    way: float  # [m] that the hand went since then
    velocity: float  # [m/s] at which it goes on
    dragged: float = 0.0  # [m^2/s] times a damping at the hand [N s/m]: what that dissipated [J]


class Rendered(NamedTuple):
    """What the hand shall feel."""

    force: float  # [N]
    port: Port


class Pulled(NamedTuple):
    """The slave's port at a tick."""

    force: float  # [N] that the tip feels
    way: float  # [m] that it was asked to go since the last tick
    lag: float  # [m] by which it was behind what was asked, then
    velocity: float  # [m/s] at which it is asked to go on


class Followed(NamedTuple):
    """Where the tip shall go."""

    way: float  # [m]
    velocity: float  # [m/s]
    port: Port
