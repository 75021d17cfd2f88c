"""How far an estimate was from the bench sensors, in shares of full scale, phase by phase."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array

PHASES = ("pull", "pull to release", "release", "release to pull", "pull again")
"""Of a pull, a release and a pull, in the order in which they come."""

WHOLE = "whole run"

TAUT = 0.01  # of the largest T_in, from which on a pull from slack counts
MOVED = 0.005  # of full scale: by so much T_out has left its value at the turn when it follows


class Errors(NamedTuple):
    """Of one signal over some samples, in shares of the largest true value of the whole run."""

    largest: float
    average: float


class Score(NamedTuple):
    """Of one method on one run."""

    force: Errors
    elongation: Errors


class Truth(NamedTuple):
    """What the bench's sensors tell of a run, shape (n,), and which phase each sample is of."""

    distal_tension: Array  # [N]
    elongation: Array  # [m]
    phase: dict[str, NDArray[np.bool_]]  # samples, by name; WHOLE is all that counts


def score(truth: Truth, distal_tension: Array, elongation: Array) -> dict[str, Score]:
    """Return the errors of an estimate, phase by phase."""
    return {
        name: Score(
            errors(distal_tension, truth.distal_tension, where),
            errors(elongation, truth.elongation, where),
        )
        for name, where in truth.phase.items()
    }


def taut(T_in: Array) -> NDArray[np.bool_]:
    """Return the samples from where a pull from slack has first reached `TAUT`."""
    begins = int(np.argmax(T_in >= TAUT * T_in.max()))
    return np.arange(len(T_in)) >= begins


def errors(estimate: Array, truth: Array, where: NDArray[np.bool_] | None = None) -> Errors:
    """Return the largest and the average |estimate - truth| over full scale.

    Full scale is the largest `truth` of the whole run, whatever samples `where` picks. Without any
    sample both are NaN, as for a phase that never came.
    """
    off = np.abs(estimate - truth) / float(truth.max())
    if where is not None:
        off = off[where]
    if not off.size:
        return Errors(float("nan"), float("nan"))
    return Errors(float(off.max()), float(off.mean()))


def phases(leg: NDArray[np.int64], T_in: Array, T_out: Array) -> NDArray[np.int64]:
    """Return which of `PHASES` each sample belongs to, told by the tip itself and no law.

    A transition lasts from the turn of `T_in` until `T_out` has left the value it had there.

    Parameters
    ----------
    leg : ndarray
        0 while the motor pulls, 1 while it releases, 2 while it pulls again.
    T_in, T_out : ndarray
        Tensions [N].
    """
    scale = MOVED * float(T_out.max())
    label = np.zeros(len(leg), dtype=np.int64)
    for turn, begins in ((_turn(T_in, leg <= 1), 1), (_turn(-T_in, leg >= 1), 3)):
        label[turn:] = begins
        follows = np.abs(T_out[turn:] - T_out[turn]) > scale
        if follows.any():
            label[turn + int(np.argmax(follows)) :] = begins + 1
    return label


def _turn(signal: Array, where: NDArray[np.bool_]) -> int:
    """Return the index of the largest of the signal among the samples `where`."""
    candidates = np.flatnonzero(where)
    return int(candidates[np.argmax(signal[candidates])])
