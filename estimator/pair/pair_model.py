"""An antagonistic pair of tendons that bends one joint: the angle, from command or tensions.

Each tendon obeys the law of one tendon (docs/explanation/theory.md (T10), section 8), with the
joint so stiff that it takes up hardly any of the tendons' travel, as for a tip that is blocked. The
motor pulls one of them in by what it lets the other out; the joint bends by what one tip pulls more
than the other:

    stiffness (angle - neutral) = T_out,a - T_out,b -+ joint friction.

No pulley's radius is needed: travel is an angle of the motor, compliance is command per newton.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from estimator import noise_treatment
from estimator.array_types import Array
from estimator.lumped.lumped_model import Motion, Physics, simulate_by_tension, simulate_by_travel
from estimator.lumped.nodes import PLACES, build_even_weights

BEDDING = 1.0
"""Tension [N] over which strands bed in."""

_PULLEY = 0.01  # [m]: any radius gives the same angles and tensions
_STEPS = 12  # in which a tendon is pretensioned before a record begins
_WEIGHTS = build_even_weights()


class PairRecord(NamedTuple):
    """A record of a pair at one shape of its sheath; arrays have shape (n,)."""

    bend: float  # of the sheath [rad]
    time: Array  # [s], rising
    command: Array  # [rad] of the motor: a is pulled in by as much as b is let out
    angle: Array  # of the joint [rad], measured
    tension_a: Array  # [N] at the housing
    tension_b: Array  # [N] at the housing

    @property
    def span(self) -> float:
        """Peak to peak of the measured angle [rad]."""
        return float(np.ptp(self.angle))


class PairModel(NamedTuple):
    """One pair, whatever the shape of its sheath."""

    friction: float  # K of the straight sheath, with the bending section
    growth: float  # mu: K = friction + growth bend
    compliance: float  # [rad/N] of each tendon: command per newton, without friction
    bedding: float  # [N]: a tendon stretches more by compliance bedding (1 - exp(-T/BEDDING))
    stiffness: float  # of the joint [N/rad]
    joint_friction: float  # [N] between the tips of the tendons
    neutral: float  # angle [rad] at which the joint pulls at neither tendon

    def compute_friction(self, bend: float) -> float:
        """Return K of each tendon at a bend [rad] of the sheath."""
        return self.friction + self.growth * bend


class PairMotion(NamedTuple):
    """What a pair does, shape (n,) each."""

    angle: Array  # [rad]
    tension_a: Array  # [N] at the housing
    tension_b: Array  # [N]


def simulate_by_command(model: PairModel, record: PairRecord) -> PairMotion:
    """Return what the command makes of a pair; of the tensions only the first are used.

    The pretension is taken to have been pulled in from slack, so that the tendons remember a pull.
    """
    return combine_tendons(model, *simulate_tendons_by_command(model, record))


def simulate_by_tensions(model: PairModel, record: PairRecord) -> PairMotion:
    """Return what the measured tensions make of a pair; the command is not used.

    The compliance of the tendons does not matter then.
    """
    return combine_tendons(model, *simulate_tendons_by_tensions(model, record))


def simulate_tendons_by_command(model: PairModel, record: PairRecord) -> tuple[Motion, Motion]:
    """Return what tendons a and b do; the joint's parameters do not matter."""
    K = model.compute_friction(record.bend)
    a = _simulate_by_travel(model, K, record.time, record.command, record.tension_a[0])
    b = _simulate_by_travel(model, K, record.time, -record.command, record.tension_b[0])
    return a, b


def simulate_tendons_by_tensions(model: PairModel, record: PairRecord) -> tuple[Motion, Motion]:
    """Return what tendons a and b do under the measured tensions."""
    K = model.compute_friction(record.bend)
    a = _simulate_by_tension(model, K, record.time, record.tension_a)
    b = _simulate_by_tension(model, K, record.time, record.tension_b)
    return a, b


def combine_tendons(model: PairModel, a: Motion, b: Motion) -> PairMotion:
    """Return what the joint makes of two tendons; only its own parameters matter."""
    pull = (a.distal_tension - b.distal_tension) / model.stiffness + model.neutral
    # the play of the joint's friction begins at zero
    angle = noise_treatment.apply_play(
        np.append(0.0, pull), model.joint_friction / model.stiffness
    )[1:]
    return PairMotion(angle, a.proximal_tension, b.proximal_tension)


def _build_physics(model: PairModel, K: float) -> Physics:
    compliance = _PULLEY * model.compliance
    return Physics(
        np.array([K]), compliance, _WEIGHTS, toe=compliance * model.bedding, toe_tension=BEDDING
    )


def _simulate_by_travel(
    model: PairModel, K: float, time: Array, command: Array, start: float
) -> Motion:
    pulled = max(start, 0.0) * np.exp(-K * PLACES)
    bedded = model.bedding * -np.expm1(-pulled / BEDDING)
    taken_up = _PULLEY * model.compliance * float(_WEIGHTS @ (pulled + bedded))
    travel = taken_up + _PULLEY * (command - command[0])
    return _simulate_after_pull(_build_physics(model, K), time, travel, simulate_by_travel)


def _simulate_by_tension(model: PairModel, K: float, time: Array, tension: Array) -> Motion:
    return _simulate_after_pull(
        _build_physics(model, K), time, np.maximum(tension, 0.0), simulate_by_tension
    )


def _simulate_after_pull(
    physics: Physics,
    time: Array,
    drive: Array,
    simulate: Callable[[Physics, Array, Array, Array], Motion],
) -> Motion:
    pull = np.linspace(0.0, drive[0], _STEPS, endpoint=False)
    pull_time = time[0] + np.arange(-_STEPS, 0, dtype=np.float64)
    speed = np.zeros(_STEPS + len(time))
    motion = simulate(
        physics, np.concatenate([pull_time, time]), np.concatenate([pull, drive]), speed
    )
    return Motion(*(row[_STEPS:] for row in motion))
