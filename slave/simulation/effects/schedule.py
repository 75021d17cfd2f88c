"""Apply effects over time to the constants of a healthy rig.

Constants are rebuilt only when an effect starts or while one varies.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from estimator.array_types import Array
from slave.simulation.effects.effect import (
    Effect,
    TendonEffect,
    compute_deviations,
    select_tendon_effects,
)
from slave.simulation.effects.ends import JointEffect
from slave.simulation.effects.sensors import LostSamples, SampleEffect, SensorEffect
from slave.simulation.joint import Joint
from slave.simulation.sensor_models import Sensors


class JointSchedule:
    """The effects in the physics of one joint, with time and travel since their start.

    `index` counts the rig's joints from 0; `joint` is the healthy one.
    """

    def __init__(self, effects: Sequence[Effect], index: int, joint: Joint) -> None:
        self._healthy = joint
        self._ends = [
            effect
            for effect in effects
            if isinstance(effect, JointEffect) and effect.joint in (None, index + 1)
        ]
        sides: tuple[Literal["a", "b"], ...] = ("a", "b") if joint.pair else ("a",)
        self._tendon_effects = {side: select_tendon_effects(effects, index, side) for side in sides}
        self._all = [
            *self._ends,
            *(effect for of in self._tendon_effects.values() for effect in of),
        ]
        self._began: dict[Effect, float] = {}  # travel of the joint [m] at the start
        self._slid = {side: np.zeros(len(of)) for side, of in self._tendon_effects.items()}
        self._before = np.zeros(2)

    def update_joint(
        self, time: float, travel: float, housing: Array, is_changing: bool = False
    ) -> Joint | None:
        """Return the joint from `time` [s] on, or None if unchanged.

        `travel` [m] is the joint's position, `housing` [m], shape (tendons,), its housing ends. The
        healthy joint `is_changing` too where its environment is ramped.
        """
        if not self._all:
            return None
        travels = abs(housing - self._before[: len(housing)])
        self._before = housing
        for (side, of), way in zip(self._tendon_effects.items(), travels, strict=True):
            self._slid[side] += [way if effect in self._began else 0.0 for effect in of]
        begins = [e for e in self._all if e.start <= time and e not in self._began]
        self._began |= dict.fromkeys(begins, travel)
        if not (begins or is_changing or any(is_varying(effect) for effect in self._began)):
            return None
        return self._build_joint(time)

    def _build_joint(self, time: float) -> Joint:
        joint = self._healthy
        for side, effects in self._tendon_effects.items():
            tendon = getattr(joint, side)
            deviations = compute_deviations(effects, time, self._slid[side].tolist())
            tendon = tendon._replace(chain=tendon.chain._replace(deviations=deviations))
            joint = joint._replace(**{side: tendon})
        for effect in self._ends:
            if effect in self._began:
                joint = effect.apply(joint, self._began[effect])
        return joint


class SensorSchedule:
    """The effects in the sensors of a rig.

    `joints` are the tendons of each joint (`slave.rig.Rig`); `sensors` are the healthy ones.
    """

    def __init__(
        self, effects: Sequence[Effect], joints: Sequence[Sequence[int]], sensors: Sensors
    ) -> None:
        self._healthy = sensors
        self._all = [effect for effect in effects if isinstance(effect, SensorEffect)]
        self._tendons = [find_affected_tendons(effect, joints) for effect in self._all]
        self._began = 0

    def update_sensors(self, time: float) -> Sensors | None:
        """Return the sensors from `time` [s] on, or None if unchanged."""
        active = [(e, t) for e, t in zip(self._all, self._tendons, strict=True) if e.start <= time]
        if len(active) == self._began and not any(is_varying(effect) for effect, _ in active):
            return None
        self._began = len(active)
        sensors = self._healthy
        for effect, tendons in active:
            sensors = effect.apply(sensors, tendons, time - effect.start)
        return sensors


class SampleSchedule:
    """The effects on whole samples: lost and repeated ones."""

    def __init__(self, effects: Sequence[Effect], seed: int) -> None:
        self._all = [effect for effect in effects if isinstance(effect, SampleEffect)]
        self._struck = [False] * len(self._all)
        self._random = np.random.default_rng([seed, 1])  # independent of the noise
        self._last: Array | None = None

    def transmit(self, time: float, reading: Array) -> Array | None:
        """Return the reading that arrives at `time` [s], None if it is lost."""
        for i, effect in enumerate(self._all):
            if effect.start <= time:
                self._struck[i] = effect.is_struck(self._struck[i], self._random.random())
        struck = [e for e, is_struck in zip(self._all, self._struck, strict=True) if is_struck]
        if any(isinstance(effect, LostSamples) for effect in struck):
            return None
        if self._last is not None and struck:
            return self._last
        self._last = reading
        return reading


def find_affected_tendons(effect: SensorEffect, joints: Sequence[Sequence[int]]) -> list[int]:
    """Return the tendons whose sensors have `effect`, counted over the rig."""
    sides = {"a": (0,), "b": (1,), "both": (0, 1)}[effect.tendon]
    return [
        tendon
        for index, tendons in enumerate(joints)
        if effect.joint in (None, index + 1)
        for side, tendon in enumerate(tendons)
        if side in sides
    ]


def is_varying(effect: Effect) -> bool:
    """Return whether an effect varies after its start."""
    return isinstance(effect, TendonEffect | SensorEffect) and effect.varies
