"""The estimator of Phee et al. 2009, as a reader of the paper would build it.

Initialisation: the motor pulls on after the joint has met its stop. M_e = e_out/T_in, with e_out
the travel pulled in since the stop and T_in the reading of the load cell, K from (13) with the
length and the stiffness that are known beforehand. Then the sign of dT_in/dt decides the phase and
T_in0 is its last maximum or minimum:

    phase              T_out           elongation
    pull               (4)             (11)
    pull to release    (14)            (21)    until T_in has fallen to T_in0 e^(-2K)
    release            (22)            (23)
    release to pull    (24)            (25)    until T_in has risen to T_in0 e^(2K)

Printed wrongly are (11), (13), (22) and (24); they are used as they have to read
(`studies.paper.equations`, docs/explanation/theory.md section 2).

The paper's equations hold after a full pull or a full release. For a reversal inside a transition
it has none, and (24) then makes T_out jump by up to e^(2K). ``continued`` grants it what its text
says of every transition, that T_out stays as it is, and elongations that go on from where they
were.

The paper does not speak of noise. Here T_in is averaged, and has turned when it has come back from
its extreme by more than the noise would; without both, every sample would be a reversal.
"""

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from studies.paper import equations as paper

TIME_CONSTANT = 0.01  # [s] of the average: noise falls to a fifth at 1 kHz, a swing takes seconds
TURN = 10.0  # sigma of the average by which it turns: over minutes, extremes are 5 off each way
LEAST_TURN = 1e-3  # [N]
LEAST_TENSION = 1e-6  # [N]


class Phase(IntEnum):
    """The phases of the paper."""

    PULL = 0
    PULL_TO_RELEASE = 1
    RELEASE = 2
    RELEASE_TO_PULL = 3


@dataclass(frozen=True, slots=True)
class PaperModel:
    """What initialisation gives, and what is known beforehand."""

    M_e: float  # [m/N]
    K: float
    length: float  # [m]
    axial_stiffness: float  # EA [N]


class MethodState(NamedTuple):
    """What the method remembers from sample to sample."""

    phase: Phase
    extreme: float  # [N] largest T_in since it began to rise, least since it began to fall
    turned_at: float  # T_in0 [N], the last extreme that was left
    held: float  # [N] T_out during a transition
    offset: float  # [m] of the elongation during a transition


class Estimates(NamedTuple):
    """Of a whole record, shape (n,)."""

    distal_tension: Array  # [N]
    elongation: Array  # [m]
    phase: NDArray[np.int64]


def build_model(M_e: float, length: float, axial_stiffness: float) -> PaperModel:
    """Return the model that belongs to an elongation constant M_e [m/N].

    Raises
    ------
    ValueError
        If M_e is larger than without any friction, so that (13) has no solution.
    """
    K = paper.compute_friction_from_pull(M_e, length, axial_stiffness)
    return PaperModel(M_e, K, length, axial_stiffness)


def run_method(
    model: PaperModel, time: Array, tension: Array, noise: float, continued: bool = False
) -> Estimates:
    """Return what the method makes of T_in [N] at `time` [s], with white noise [N] of that sigma.

    The record begins with a pull from zero tension.
    """
    smooth, sigma = _average_tension(time, tension, noise)
    band = max(TURN * sigma, LEAST_TURN)
    memory = MethodState(Phase.PULL, 0.0, 0.0, 0.0, 0.0)
    rows = []
    for T_in in np.maximum(smooth, LEAST_TENSION).tolist():
        memory = advance(model, memory, T_in, band, continued)
        rows.append((*_read_estimate(model, memory, T_in), memory.phase))
    T_out, e, phase = zip(*rows, strict=True)
    return Estimates(np.array(T_out), np.array(e), np.array(phase, dtype=np.int64))


def advance(
    model: PaperModel, memory: MethodState, T_in: float, band: float, continued: bool
) -> MethodState:
    """Return the memory after T_in [N], which has turned when `band` [N] from its last extreme."""
    K = model.K
    rising = memory.phase in (Phase.PULL, Phase.RELEASE_TO_PULL)
    if rising and T_in < memory.extreme - band:
        memory = _turn_back(model, memory, Phase.PULL_TO_RELEASE, T_in, continued)
    elif not rising and T_in > memory.extreme + band:
        memory = _turn_back(model, memory, Phase.RELEASE_TO_PULL, T_in, continued)
    else:
        extreme = max(memory.extreme, T_in) if rising else min(memory.extreme, T_in)
        memory = memory._replace(extreme=extreme)
    if (
        memory.phase is Phase.PULL_TO_RELEASE
        and paper.compute_release_tip_tension(T_in, K) < memory.held
    ):
        return memory._replace(phase=Phase.RELEASE)
    if (
        memory.phase is Phase.RELEASE_TO_PULL
        and paper.compute_pull_tip_tension(T_in, K) > memory.held
    ):
        return memory._replace(phase=Phase.PULL)
    return memory


def _turn_back(
    model: PaperModel, memory: MethodState, phase: Phase, T_in: float, continued: bool
) -> MethodState:
    """Return the memory after a reversal at the last extreme, noticed at T_in [N]."""
    at = memory.extreme
    hold = (
        paper.compute_pull_to_release_tension
        if phase is Phase.PULL_TO_RELEASE
        else paper.compute_release_to_pull_tension
    )
    turned = MethodState(phase, T_in, at, float(hold(at, model.K)), 0.0)
    if continued:
        T_out, e = _read_estimate(model, memory, at)
        turned = turned._replace(held=T_out, offset=e - _read_estimate(model, turned, at)[1])
    return turned


def _read_estimate(model: PaperModel, memory: MethodState, T_in: float) -> tuple[float, float]:
    """Return T_out [N] and the elongation [m]."""
    K, M_e, L, EA = model.K, model.M_e, model.length, model.axial_stiffness
    match memory.phase:
        case Phase.PULL:
            return float(paper.compute_pull_tip_tension(T_in, K)), M_e * T_in
        case Phase.RELEASE:
            e = paper.compute_release_elongation(T_in, M_e, K)
            return float(paper.compute_release_tip_tension(T_in, K)), float(e)
        case Phase.PULL_TO_RELEASE:
            e = paper.compute_pull_to_release_elongation(memory.turned_at, T_in, K, L, EA)
        case Phase.RELEASE_TO_PULL:
            e = paper.compute_release_to_pull_elongation(memory.turned_at, T_in, K, L, EA)
    return memory.held, float(e) + memory.offset


def _average_tension(time: Array, tension: Array, noise: float) -> tuple[Array, float]:
    """Return the average of `TIME_CONSTANT` over T_in and the noise that it leaves."""
    steps = np.diff(time, prepend=time[0])
    keep = np.exp(-steps / TIME_CONSTANT).tolist()
    mean, means = 0.0, []
    for kept, T in zip(keep, tension.tolist(), strict=True):
        mean = T + (mean - T) * kept
        means.append(mean)
    kept = math.exp(-float(np.median(steps)) / TIME_CONSTANT)
    return np.array(means), noise * math.sqrt((1.0 - kept) / (1.0 + kept))
