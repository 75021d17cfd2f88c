"""The rig interface: motors and sensors at the housing, simulated, replayed or real."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, cast

import numpy as np

from estimator.array_types import Array


@dataclass(slots=True)  # made every tick: frozen, that would take seven times as long
class RigSample:
    """One sample of a rig; arrays have shape (tendons,).

    The two bench arrays are for evaluation, recording and display. Estimators and controllers never
    use them; they are None if the rig has no such sensor.
    """

    time_s: float  # [s] on the rig's own clock, increasing; only differences count
    proximal_tension: Array  # [N] at the housing
    proximal_displacement: Array | None  # [m] pulled in at the housing; None without an encoder
    bench_distal_tension: Array | None = None  # [N] at the tip
    bench_distal_displacement: Array | None = None  # [m] at the tip, positive towards the housing
    # [N] at the two ends of a sensing loop in the tube of each tendon; NaN where there is none
    loop_moved_tension: Array | None = None
    loop_held_tension: Array | None = None


def collect_loop_tensions(samples: Sequence[RigSample]) -> Array | None:
    """Return tensions [N] of sensing loops, shape (ends, samples, tendons), None without loops."""
    if samples[0].loop_moved_tension is None:
        return None
    return np.array(
        [[s.loop_moved_tension for s in samples], [s.loop_held_tension for s in samples]]
    )


class RigFault(Exception):
    """A failure of the rig's sensors or motors; the message gives the reason."""


class Rig(Protocol):
    """Interface of a tendon rig to the slave loop.

    Opened by its constructor, used from one thread, closed exactly once. `read` and `write` must
    return well within a millisecond and never wait for hardware. A failure, of the constructor
    too, raises `RigFault`; the loop then goes to fault and calls nothing but `summary` and `close`.

    Attributes
    ----------
    name : str
        Name of the rig in calibration files.
    tendons : int
        Their number, 1 to `teleop.messages.messages.MAX_TENDONS`.
    joints : tuple of tuples of int
        The tendons of each joint, counted from 0 over the whole rig: one that works against a
        return spring, or an antagonistic pair `a`, `b`. Every tendon belongs to one joint, as in
        ((0, 1), (2, 3)) or ((0,),), numbered joint after joint; at most
        `MAX_JOINTS` of them. Joint travel is positive in the pulling direction of
        `a`; the tip of `a` travels with the joint, that of `b` against it.
    starts_at_zero : bool
        Whether its motors are at position 0 when it is opened and stay there until the first write,
        so that no encoder is needed. Otherwise nothing is written before the encoders of all
        tendons have given a position.
    """

    name: str
    tendons: int
    joints: tuple[tuple[int, ...], ...]
    starts_at_zero: bool

    def read(self, time_s: float) -> tuple[RigSample, ...]:
        """Return the samples that are new at session time `time_s` [s], oldest first.

        Often none or one, several if they arrive faster than the reads; each is returned once.
        `time_s` never decreases. A simulated rig advances its plant to that time; a replayed one
        returns the rows due by then and raises `RigFinished` after its last; a real one returns the
        samples received since the last read.
        """

    def write(self, proximal_displacement: Array) -> None:
        """Set the motor positions [m], shape (tendons,), in the encoders' coordinates.

        Called with the output of the gate: in a session at every tick from the first engagement on,
        or from the first tick on after a calibration at its start; and during a calibration, when
        nobody is engaged.
        """

    def advance(self) -> RigSample | None:
        """Do work that is not time-critical: called once per tick, after the state was sent.

        A simulated rig computes the next step of its plant here and returns the sample object that
        the next `read` will return if that comes in time, so that the estimate is computed in
        advance. A real rig returns None.
        """

    def summarise(self) -> dict[str, int | float | str]:
        """Return the rig's entries for the run summary, often none; never raises."""

    def close(self) -> None:
        """Stop the motors where they are and release the hardware; never raises."""


class EnablingRig(Rig, Protocol):
    """A rig that enables its motors at the first write, which takes them a while.

    Attributes
    ----------
    follows : bool
        Whether all motors follow what is written, as of the last `read`; false before the first
        write and after an emergency stop. Until then positions are written that the encoders have
        given last, so that a motor stays where it is as it is enabled. Motors that cannot be
        enabled are a `RigFault`.
    """

    follows: bool


class StoppableRig(Rig, Protocol):
    """A rig whose motors have a stop of their own, beyond being held where they are."""

    def emergency_stop(self) -> None:
        """Stop the motors by their own means.

        Called once as the session is stopped, engaged or not, also before anything was written; and
        as a stop ends a calibration at the slave's start. Nothing is written until an operator has
        reset the stop and engages again; then the first positions are those that the encoders have
        given last.
        """


class WatchedRig(Rig, Protocol):
    """A rig that stops its motors when its loop hangs, that is when it is not read for long."""

    def announce_pause(self) -> None:
        """Announce that it will not be read for some seconds; the motors hold meanwhile.

        The next `read` ends the pause.
        """


class AdjustableRig(Rig, Protocol):
    """A rig whose environment has numbers that may change while it runs."""

    def set_environment(self, joint: int, part: int | None, name: str, value: float) -> None:
        """Let a number of an environment go to `value`, without a step in a force.

        Parameters
        ----------
        joint : int
            From 0.
        part : int or None
            Of an environment of several parts, from 0.
        name : str
            As in the config.
        value : float
            In the unit of the config.

        Raises
        ------
        ValueError
            There is no such number, or it cannot have this value.
        """


def get_environment_setter(
    rig: Rig,
) -> Callable[[int, int | None, str, float], None] | None:
    """Return `set_environment` of an `AdjustableRig`, None of any other rig."""
    return getattr(rig, "set_environment", None)


def get_emergency_stop(rig: Rig) -> Callable[[], None] | None:
    """Return the emergency stop of a `StoppableRig`, None of any other rig."""
    return getattr(rig, "emergency_stop", None)


def as_enabling_rig(rig: Rig) -> EnablingRig | None:
    """Return a rig that tells whether its motors follow as one, None for any other."""
    return cast("EnablingRig", rig) if hasattr(rig, "follows") else None


def has_following_motors(rig: Rig) -> bool:
    """Return whether the motors of a rig follow what is written; always true if it cannot tell."""
    enabling = as_enabling_rig(rig)
    return enabling is None or enabling.follows


class RigFinished(Exception):
    """A replayed rig has played its last row; the session ends without a fault."""


# --- numbers of the tendons of a rig's joints


def number_joint_tendons(counts: list[int]) -> tuple[tuple[int, ...], ...]:
    """Return which tendons each joint has: numbered from 0, joint after joint."""
    joints, first = [], 0
    for count in counts:
        joints.append(tuple(range(first, first + count)))
        first += count
    return tuple(joints)
