"""The contract of a rig: motors and sensors at the housing, simulated, replayed or real."""

from dataclasses import dataclass
from typing import Protocol

from estimator.array_types import Array


@dataclass(frozen=True, slots=True)
class RigSample:
    """What one read of the rig returns; arrays have shape (tendons,).

    The two bench arrays are for judging, recording and showing. They are never given to an
    estimator or a controller, and are None where the rig has no such sensor.
    """

    time_s: float  # [s] on the rig's own clock, increasing; only differences count
    proximal_tension: Array  # [N] at the housing
    proximal_displacement: Array | None  # [m] pulled in at the housing; None without an encoder
    bench_distal_tension: Array | None = None  # [N] at the tip
    bench_distal_displacement: Array | None = None  # [m] at the tip, positive towards the housing


class RigFault(Exception):
    """The rig can no longer be trusted to measure or to obey; the message says why."""


class Rig(Protocol):
    """A tendon rig as the slave loop sees it.

    Opened by its constructor, used from one thread, closed exactly once. `read` and `write` must
    return well within a millisecond and never wait for hardware. A failure, of the constructor
    too, raises `RigFault`; the loop then goes to fault and calls nothing but `summary` and `close`.

    Attributes
    ----------
    name : str
        By which calibration files know it.
    tendons : int
        How many it has, 1 to `teleop.messages.MAX_TENDONS`.
    joints : tuple of tuples of int
        The tendons of each joint, counted from 0 over the whole rig: one that works against a
        return spring, or a pair `a`, `b` that work against each other. Every tendon belongs to one
        joint, as in ((0, 1), (2, 3)) or ((0,),); at most `teleop.messages.MAX_JOINTS` of them.
        Joint travel is positive where `a` pulls, so the tip of `a` travels with the joint and
        that of `b` against it.
    starts_at_zero : bool
        Whether its motors stand at 0 by their own count when it is opened and stay there until the
        first write, so that no encoder is needed to know. Otherwise nothing is ever written before
        encoders have told, for all tendons, where the motors stand.
    """

    name: str
    tendons: int
    joints: tuple[tuple[int, ...], ...]
    starts_at_zero: bool

    def read(self, time_s: float) -> tuple[RigSample, ...]:
        """Return the samples that are new at session time `time_s` [s], oldest first.

        Often none or one, several when they come faster than the reads; each is returned once.
        `time_s` never decreases. A simulated rig advances its plant to that time; a replayed one
        gives the rows due by then and raises `RigFinished` behind its last; a real one gives what
        its sensors sent since the last read.
        """

    def write(self, proximal_displacement: Array) -> None:
        """Set the motor positions [m], shape (tendons,), counted as the encoders count.

        Called with what the gate let through: in a session at every tick from the first engagement
        on, and in a calibration, by command or at the slave's start, with nobody engaged.
        """

    def advance(self) -> RigSample | None:
        """Do what nobody waits for: called once a tick, when the answer to the master is out.

        A simulated rig computes the next step of its plant here, and returns the sample that the
        next `read` gives if it comes when that is due: that very object, which is estimated from
        in advance. Only a rig whose sample gets no newer by waiting may do so; a real one returns
        None, and most have nothing to do.
        """

    def summary(self) -> dict[str, int | float | str]:
        """Return what the summary of a run shall tell of the rig, often nothing; never raises."""

    def close(self) -> None:
        """Stop the motors where they are and let go of the hardware; never raises."""


class RigFinished(Exception):
    """A replayed rig has played its last row: the session ends without fault."""
