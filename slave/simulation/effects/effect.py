"""Base classes of effects: place, start time and parameter ranges."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

from slave.simulation.tendon import TendonDeviations
from teleop.config.ranges import RangedConfig, build_ranged_field


@dataclass(frozen=True, slots=True)
class Effect(RangedConfig):
    """A deviation from the estimator's model, active from `start` on."""

    joint: int | None = build_ranged_field(None, 1, math.inf)  # counted from 1; null = every joint
    # of the rig, from which on it is active
    start: float = build_ranged_field(0.0, 0.0, math.inf, "s")

    adds_up: ClassVar[bool] = True  # whether two of them on one tendon accumulate


@dataclass(frozen=True, slots=True)
class TendonEffect(Effect, ABC):
    """An effect in the physics of a tendon and its sheath."""

    tendon: Literal["a", "b", "both"] = "both"  # of the joint, on which it acts

    varies: ClassVar[bool] = False  # whether it varies after its start

    @abstractmethod
    def apply(self, deviations: TendonDeviations, time: float, slid: float, /) -> TendonDeviations:
        """Return the deviations with this effect added.

        `time` [s] is since its start, `slid` [m] the accumulated travel of the tendon's housing end
        since then.
        """


def select_tendon_effects(
    effects: Sequence[object], joint: int, tendon: Literal["a", "b"]
) -> tuple[TendonEffect, ...]:
    """Return the effects that act in tendon `tendon` of joint `joint`, counted from 0."""
    return tuple(
        effect
        for effect in effects
        if isinstance(effect, TendonEffect)
        and effect.joint in (None, joint + 1)
        and effect.tendon in (tendon, "both")
    )


def compute_deviations(
    effects: Sequence[TendonEffect], time: float, slid: Sequence[float]
) -> TendonDeviations:
    """Return the deviations of a tendon at `time` [s] under all its effects.

    `slid` [m] is the accumulated travel of the tendon's housing end since the start of each.
    """
    deviations = TendonDeviations()
    for effect, distance in zip(effects, slid, strict=True):
        if time >= effect.start:
            deviations = effect.apply(deviations, time - effect.start, distance)
    return deviations
