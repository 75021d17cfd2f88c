"""Sensing loops of the simulated rig: a tendon to the tip and back in the tube of another.

A motor moves one end to and fro, a spring holds the other; a load cell is at each. The tube's
shape, and so each bend, is that of the other tendon, there and back.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimator.array_types import Array
from slave.simulation.environment import FreeConfig, build_environment
from slave.simulation.joint import (
    BodyConfig,
    Joint,
    Tendon,
    Winding,
    advance_joints,
    build_body,
    init_joint,
    replace_item,
    to_compiled_list,
)
from slave.simulation.motor import MotorConfig, build_motor
from slave.simulation.tendon import NEUTRAL, SheathConfig, build_chain
from teleop.config.ranges import RangedConfig, build_ranged_field


@dataclass(frozen=True, slots=True)
class SensingLoopConfig(RangedConfig):
    """A thin tendon with less friction than the one beside it."""

    friction: float = build_ranged_field(0.05, 0.0, 2.0)  # mu of it, dimensionless
    axial_stiffness: float = build_ranged_field(9000.0, 1.0, 1e7, "N")  # EA of its tendon
    pretension: float = build_ranged_field(5.0, 0.1, 100.0, "N")  # of the loop at rest
    spring: float = build_ranged_field(500.0, 1.0, 1e5, "N/m")  # at the held end
    travel: float = build_ranged_field(0.005, 1e-4, 0.02, "m")  # amplitude of the moved end
    period: float = build_ranged_field(1.0, 0.05, 60.0, "s")  # of that motion
    noise: float = build_ranged_field(0.010, 0.0, 10.0, "N")  # standard deviation of both cells


def build_loop(config: SensingLoopConfig, sheath: SheathConfig) -> Joint:
    """Return the plant of a loop in the tube of a tendon: a tendon against the spring."""
    there_and_back = replace(
        sheath,
        sections=(*sheath.sections, *reversed(sheath.sections)),
        friction=config.friction,
        axial_stiffness=config.axial_stiffness,
        nodes=2 * sheath.nodes,
    )
    pull = config.pretension
    motor, chain = build_motor(MotorConfig(), pull), build_chain(there_and_back, pull)
    body = build_body(BodyConfig(spring=config.spring, pretension=pull), 1)
    tendon = Tendon(motor, Winding(), chain)
    return Joint(tendon, tendon, False, body, build_environment(FreeConfig()))


def compute_loop_target(config: SensingLoopConfig, time: float) -> float:
    """Return the position of the moved end at `time` [s] in m."""
    return config.travel * math.sin(2.0 * math.pi * time / config.period)


class SensingLoops:
    """The loops of a rig's tendons, None where there is none.

    `readings` are the tensions at the moved and the held ends [N], shape (tendons,), NaN where
    there is none; empty without any loop.
    """

    def __init__(
        self,
        configs: Sequence[SensingLoopConfig | None],
        sheaths: Sequence[SheathConfig],
        seed: int,
    ) -> None:
        self._tendons = [i for i, config in enumerate(configs) if config is not None]
        self._configs = [config for config in configs if config is not None]
        self._count = len(configs)
        self._random = np.random.default_rng([seed, 2])  # independent of the other noise
        self.readings: tuple[Array, ...] = ()
        if not self._configs:
            return
        self._healthy = [
            build_loop(config, sheaths[i])
            for i, config in zip(self._tendons, self._configs, strict=True)
        ]
        self._joints = to_compiled_list(self._healthy)
        self._states = to_compiled_list([init_joint(joint) for joint in self._healthy])
        self.advance(0.0, 1, 1e-3)

    def scale_friction(self, tendon: int, scale: float) -> None:
        """Let all friction of the tube of a tendon be `scale` times that of its config."""
        if tendon in self._tendons:
            k = self._tendons.index(tendon)
            joint, deviations = self._healthy[k], NEUTRAL._replace(friction_scale=scale)
            chain = joint.a.chain._replace(deviations=deviations)
            replace_item(self._joints, k, joint._replace(a=joint.a._replace(chain=chain)))

    def advance(self, time: float, steps: int, dt: float) -> None:
        """Advance by `steps` of `dt` [s] to `time` [s]."""
        if not self._configs:
            return
        targets = np.zeros((len(self._configs), 2))
        targets[:, 0] = [compute_loop_target(config, time) for config in self._configs]
        truth = advance_joints(self._joints, self._states, targets, steps, dt)
        noise = [[config.noise] for config in self._configs]
        ends = truth[::2, :, 0].T + noise * self._random.standard_normal((len(noise), 2))
        readings = np.full((2, self._count), np.nan)
        readings[:, self._tendons] = ends.T
        self.readings = tuple(readings)
