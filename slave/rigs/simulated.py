"""A simulated rig: motors, elastic tendons in their sheaths, loads at the tips, noisy sensors."""

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from slave.plant.chain import SheathConfig, build_chain
from slave.plant.joint import Joint, Truth, advance, at_rest
from slave.plant.load import TipConfig, build_load
from slave.plant.motor import MotorConfig, build_motor
from slave.plant.sensors import EncoderConfig, LoadCellConfig
from slave.rig import RigFault, RigSample
from teleop.messages import MAX_JOINTS

Array = NDArray[np.float64]

STEPS_AT_ONCE = 10  # of a read that comes late; later still, and the steps grow instead


@dataclass(frozen=True, slots=True)
class JointConfig:
    """One joint: a motor pulls a tendon whose tip works against a load."""

    sheath: SheathConfig = field(default_factory=SheathConfig)
    tip: TipConfig = field(default_factory=TipConfig)
    motor: MotorConfig = field(default_factory=MotorConfig)
    load_cell: LoadCellConfig = field(default_factory=LoadCellConfig)
    encoder: EncoderConfig = field(default_factory=EncoderConfig)


@dataclass(frozen=True, slots=True)
class SimulatedRigConfig:
    """A rig of one joint or several, each with one tendon and moved by one motor."""

    type: Literal["simulated"] = "simulated"
    joints: tuple[JointConfig, ...] = (JointConfig(),)
    period: float = 0.001  # [s] step of the plant
    seed: int = 1  # of the sensors' noise

    def __post_init__(self) -> None:
        """Refuse a rig that messages cannot carry."""
        if not 1 <= len(self.joints) <= MAX_JOINTS:
            raise ValueError(f"joints: must be 1 to {MAX_JOINTS}")
        if not 1e-5 <= self.period <= 0.01:
            raise ValueError("period: must be 0.00001 to 0.01 s")
        if self.seed < 0:
            raise ValueError("seed: must not be negative")


def build_joint(config: JointConfig) -> Joint:
    """Return the plant of one joint."""
    chain = build_chain(config.sheath, config.tip.pretension)
    return Joint(build_motor(config.motor), chain, build_load(config.tip))


class SimulatedRig:
    """The rig of `slave.rig.Rig`, with bench sensors that tell the truth at the tips.

    All displacements count from the start, where every tendon is at its pretension. The same
    config, reads and writes give the same samples.

    Attributes
    ----------
    tendons : int
        Number of joints, which have one tendon each.
    coarse_reads : int
        Reads that came so late that the plant went in longer steps than its period.
    """

    starts_at_zero = True

    def __init__(self, config: SimulatedRigConfig) -> None:
        self.tendons = len(config.joints)
        self.coarse_reads = 0
        self._config = config
        self._random = np.random.default_rng(config.seed)
        self._joints = [build_joint(joint) for joint in config.joints]
        self._targets = [0.0] * self.tendons
        self._step = -1  # index of the newest sample
        self._states = [at_rest(joint) for joint in self._joints]
        self._advance(1, config.period)  # changes nothing, but compiles what the loop will need

    def read(self, time_s: float) -> tuple[RigSample, ...]:
        """Advance the plant to `time_s` [s]; return its newest sample, or none if it has no new."""
        behind = round(time_s / self._config.period) - self._step
        if behind <= 0:
            return ()
        steps, dt = behind, self._config.period
        if behind > STEPS_AT_ONCE:
            steps, dt = STEPS_AT_ONCE, behind * dt / STEPS_AT_ONCE
            self.coarse_reads += 1
        self._step += behind
        return (self._sample(self._advance(steps, dt)),)

    def write(self, proximal_displacement: Array) -> None:
        """Send the motors to these displacements [m], shape (tendons,)."""
        targets = [float(target) for target in proximal_displacement]
        if len(targets) != self.tendons or not all(map(math.isfinite, targets)):
            raise RigFault(f"motors cannot follow {targets}: {self.tendons} finite values needed")
        self._targets = targets

    def summary(self) -> dict[str, int | float | str]:
        """Return how often the plant was not simulated in full."""
        return {"coarse_reads": self.coarse_reads}

    def close(self) -> None:
        """Leave the motors where they are; there is nothing to let go of."""

    def _advance(self, steps: int, dt: float) -> list[Truth]:
        truths = []
        for i, (joint, target) in enumerate(zip(self._joints, self._targets, strict=True)):
            self._states[i], truth = advance(joint, self._states[i], target, steps, dt)
            truths.append(truth)
        return truths

    def _sample(self, truths: list[Truth]) -> RigSample:
        noise = self._random.standard_normal(self.tendons).tolist()
        tension, displacement = [], []
        for joint, truth, normal in zip(self._config.joints, truths, noise, strict=True):
            tension.append(joint.load_cell.read(truth.proximal_tension, normal))
            displacement.append(joint.encoder.read(truth.proximal_displacement))
        return RigSample(
            time_s=self._step * self._config.period,
            proximal_tension=np.array(tension),
            proximal_displacement=np.array(displacement),
            bench_distal_tension=np.array([truth.distal_tension for truth in truths]),
            bench_distal_displacement=np.array([truth.distal_displacement for truth in truths]),
        )
