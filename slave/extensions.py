"""Estimators and tendon controllers of other packages (docs/how-to/own-methods.md).

Arrays have shape (tendons,), unless (joints,) is said, and are copies.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol

from estimator.array_types import Array
from estimator.online.online import TendonModel
from teleop.config.extensions import Extension


class HousingSample(NamedTuple):
    """What a rig measures at the housing, all of it finite."""

    dt: float  # [s] since the sample before, 0 for the first
    tension: Array  # [N]
    displacement: Array | None  # [m] pulled in; None without encoders


class TipEstimate(NamedTuple):
    """Estimates of a sample."""

    tension: Array  # [N] at the tip
    low: Array  # [N] least that is possible; a wide interval is felt less (`confidence`)
    high: Array  # [N] largest
    elongation: Array  # [m] of tendon and sheath: travel at the housing less travel at the tip


class TendonEstimator(Protocol):
    """An estimator of what happens at the tips."""

    def step(self, sample: HousingSample) -> TipEstimate:
        """Return the estimates of the next sample; it is not called for an incomplete one."""


class ControlInput(NamedTuple):
    """What a tendon controller knows at a tick."""

    dt: float  # [s] since the last tick
    is_first: bool  # since the operator engaged; the command is then where the joints are
    command: Array  # [m] travel of each joint, shape (joints,); only changes count
    velocity: Array  # [m/s] of it, shape (joints,)
    position: Array  # [m] estimated travel of each joint, shape (joints,)
    force: Array  # [N] estimated on each joint, shape (joints,)
    motor: Array  # [m] position of each motor, as last written
    tension: Array  # [N] at the housing; NaN for a refused sample
    tip_tension: Array  # [N] estimated
    elongation: Array  # [m] estimated


class TendonController(Protocol):
    """A controller from commanded joints to motors."""

    def step(self, state: ControlInput) -> Array:
        """Return the motor targets [m], positive = pulled in. Called while engaged only.

        The gate limits them (`slave.gate`): travel, speed, and no pull at too high a tension.
        """


@dataclass(frozen=True)
class EstimatorExtension(Extension):
    """Base of the configs of estimators of other packages (docs/how-to/own-methods.md)."""

    GROUP: ClassVar[str] = "teleop.estimators"

    def open(self, models: Sequence[TendonModel]) -> TendonEstimator:
        """Return an estimator; `models` are the calibrated ones of the tendons."""
        raise NotImplementedError


@dataclass(frozen=True)
class ControllerExtension(Extension):
    """Base of the configs of tendon controllers of other packages (docs/how-to/own-methods.md)."""

    GROUP: ClassVar[str] = "teleop.controllers"

    def open(self, joints: tuple[tuple[int, ...], ...]) -> TendonController:
        """Return a controller; `joints` has the tendons of each joint, as `Rig.joints`."""
        raise NotImplementedError
