"""Couplings of other packages: an object at either side (docs/how-to/own-methods.md).

Everything is in tip units: forces [N] positive against pulling, travels [m] positive in the pulling
direction. Arrays have shape (joints,) and are copies.
"""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol

from estimator.array_types import Array
from teleop.config.extensions import Extension

FORCE_MAX = 1e3  # [N] at a tip: beyond any of this kind
SIGNAL_MAX = 1e6  # that a message carries for a joint


class HandPort(NamedTuple):
    """The hand at the master's port, at a tick."""

    dt: float  # [s] since the last tick
    is_first: bool  # since forces are rendered
    position: Array  # [m]; only differences count
    velocity: Array  # [m/s]
    force: Array  # [N] rendered since the last tick


class TipPort(NamedTuple):
    """The tips at the slave's port, at a tick."""

    dt: float  # [s] since the last tick
    is_first: bool  # since the tips follow
    position: Array  # [m] commanded by the hand
    velocity: Array  # [m/s] of it
    force: Array  # [N] on the tips, as it is rendered
    received: Array  # newest numbers of the master's `send`


class TipMotion(NamedTuple):
    """Where the tips shall go."""

    position: Array  # [m]; at the first tick the commanded one
    velocity: Array  # [m/s]
    sent: Array  # for the master's `render`


class MasterCoupling(Protocol):
    """The master's end; called while the session is engaged, each method once a tick.

    Messages may be late, lost or out of order: only the newest is given. So send totals, such as an
    integral, not increments.
    """

    def send(self, hand: HandPort) -> Array:
        """Return the numbers for the slave, shape (joints,), of a unit of its own."""

    def render(self, tip_force: Array, received: Array) -> Array:
        """Return the forces for the hand [N], shape (joints,), zero where there are none.

        `tip_force` [N] is the newest estimate as far as it is certain; `received` the newest `sent`
        of the slave.
        """


class SlaveCoupling(Protocol):
    """The slave's end; called at each tick in which the tips follow, but the first."""

    def move(self, tip: TipPort) -> TipMotion:
        """Return the motion of the tips."""


@dataclass(frozen=True)
class CouplingExtension(Extension):
    """Base of the configs of couplings of other packages (docs/how-to/own-methods.md)."""

    GROUP: ClassVar[str] = "teleop.couplings"

    reserve: ClassVar[float] = 0.0  # [J]

    def open_master(self, joints: int) -> MasterCoupling:
        """Return the master's end for so many joints."""
        raise NotImplementedError

    def open_slave(self, joints: int) -> SlaveCoupling:
        """Return the slave's end for so many joints."""
        raise NotImplementedError
