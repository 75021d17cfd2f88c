"""The slave's section of a config file, and calibration files, which are a part of it."""

import math
from dataclasses import dataclass, field
from pathlib import Path

from estimator.online import TendonModel
from estimator.sheath import Section, Sheath
from slave.gate import GateConfig
from slave.plant.chain import SectionConfig
from slave.rigs import RigConfig
from slave.rigs.simulated import JointConfig, SimulatedRigConfig
from teleop.config import load
from teleop.errors import UsageError
from teleop.messages import MAX_JOINTS, MAX_SECTIONS

QUANTISED = math.sqrt(12.0)  # a step over the standard deviation that rounding to it adds


@dataclass(frozen=True, slots=True)
class TendonConfig:
    """What the estimator believes of one tendon and its sheath.

    Either the effective friction K of the whole sheath, as a calibration gives it, or a friction
    coefficient and the sections it acts along.
    """

    effective_friction: float | None = None  # K, dimensionless
    length: float = 1.5  # [m] with effective_friction; else the sections say
    friction: float | None = None  # mu, dimensionless
    sections: tuple[SectionConfig, ...] = ()  # housing to tip
    axial_stiffness: float = 9000.0  # EA [N] of tendon and sheath in series
    drag: float = 0.0  # tau [N], load-independent
    asymmetry: float = 1.0  # rho, friction releasing over friction pulling
    pretension: float = 0.0  # [N] all along the tendon at the start; 0 = slack
    tension_noise: float = 0.0  # [N] standard deviation at the load cell
    displacement_noise: float = 0.0  # [m] standard deviation at the encoder
    friction_error: float = 0.02  # relative error of K that the interval allows for
    elongation_error: float = 0.1  # relative error of the predicted elongation it allows for
    tip_tension_rate: float = 100.0  # [N/s] at which the tip may change unseen

    def __post_init__(self) -> None:
        """Refuse a sheath described twice or not at all."""
        if (self.effective_friction is None) == (self.friction is None):
            raise ValueError("effective_friction: give either this or friction with sections")
        if (self.friction is None) != (not self.sections):
            raise ValueError("sections: needed with friction, and only with it")
        if len(self.sections) > MAX_SECTIONS:
            raise ValueError(f"sections: at most {MAX_SECTIONS}")
        self.model()

    def model(self) -> TendonModel:
        """Return the estimator's model of this tendon."""
        if self.effective_friction is not None:
            sheath = Sheath.uniform(
                self.effective_friction,
                self.length,
                self.axial_stiffness,
                drag=self.drag,
                asymmetry=self.asymmetry,
            )
        else:
            sheath = Sheath(
                tuple(Section(s.length, s.radius) for s in self.sections),
                self.friction or 0.0,
                self.axial_stiffness,
                drag=self.drag,
                asymmetry=self.asymmetry,
            )
        return TendonModel(
            sheath,
            initial=self.pretension or "slack",
            tension_noise=self.tension_noise,
            displacement_noise=self.displacement_noise,
            friction_error=self.friction_error,
            elongation_error=self.elongation_error,
            tip_tension_rate=self.tip_tension_rate,
        )


@dataclass(frozen=True, slots=True)
class Calibration:
    """A calibration file: the models of all tendons of a rig, and where they come from."""

    tendons: tuple[TendonConfig, ...]
    method: str = ""
    source: str = ""
    believed: bool = True  # whether the method itself believes what it found
    remark: str = ""

    def __post_init__(self) -> None:
        """Refuse an empty one."""
        if not self.tendons:
            raise ValueError("tendons: at least one is needed")


@dataclass(frozen=True, slots=True)
class SlaveConfig:
    """Everything the slave process needs."""

    rig: RigConfig = field(default_factory=SimulatedRigConfig)
    tendons: tuple[TendonConfig, ...] = ()  # one for each tendon of the rig, or one for all
    calibration: Path | None = None  # a file in place of `tendons`
    gate: GateConfig = field(default_factory=GateConfig)
    freshness: float = 0.030  # [s] a command older than this makes the slave hold
    silence_max: float = 0.100  # [s] without a sample that can be used; longer is a fault

    def __post_init__(self) -> None:
        """Refuse two models, or a command that never grows old."""
        if self.tendons and self.calibration:
            raise ValueError("calibration: give either this or tendons")
        if len(self.tendons) > MAX_JOINTS:
            raise ValueError(f"tendons: at most {MAX_JOINTS}")
        if not 0.0 < self.freshness <= 0.5 or not math.isfinite(self.freshness):
            raise ValueError("freshness: must be above 0 and at most 0.5 s")
        if not 0.0 < self.silence_max <= 1.0:
            raise ValueError("silence_max: must be above 0 and at most 1 s")


def tendon_configs(config: SlaveConfig, count: int) -> tuple[TendonConfig, ...]:
    """Return the models for `count` tendons.

    From the config, or from its calibration file, or, for a simulated rig that neither describes,
    from the rig's own numbers, as a perfect calibration would find them.
    """
    tendons, place = config.tendons, "slave.tendons"
    if config.calibration is not None:
        tendons = load(config.calibration, Calibration, None).tendons
        place = str(config.calibration)
    elif not tendons and isinstance(config.rig, SimulatedRigConfig):
        return tuple(as_built(joint) for joint in config.rig.joints)
    if not tendons:
        raise UsageError(
            "slave.tendons: the estimator has no model of this sheath; give tendons, or "
            "calibration: FILE (made by `teleop estimate DATA --fit --save FILE`)"
        )
    if len(tendons) == 1:
        return tendons * count
    if len(tendons) != count:
        raise UsageError(f"{place}: {len(tendons)} tendons described, the rig has {count}")
    return tendons


def doubts(config: SlaveConfig) -> list[str]:
    """Return what is to be said of the calibration before anyone relies on it."""
    if config.calibration is None:
        return []
    calibration = load(config.calibration, Calibration, None)
    if calibration.believed:
        return []
    return [f"WARNING: {config.calibration.name} is not to be believed: {calibration.remark}"]


def as_built(joint: JointConfig) -> TendonConfig:
    """Return what a perfect calibration of a simulated joint would find."""
    return TendonConfig(
        friction=joint.sheath.friction,
        sections=joint.sheath.sections,
        axial_stiffness=joint.sheath.axial_stiffness,
        pretension=joint.tip.pretension,
        tension_noise=math.hypot(joint.load_cell.noise, joint.load_cell.resolution / QUANTISED),
        displacement_noise=joint.encoder.resolution / QUANTISED,
    )
