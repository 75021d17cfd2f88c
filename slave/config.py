"""The slave's section of a config file, and which models its estimators get."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from slave import model_files
from slave.calibration import file
from slave.calibration.config import InitialiseConfig
from slave.calibration.file import JointTendons
from slave.calibration.monitor import MonitorConfig
from slave.control import ControlConfig
from slave.fault_detection import FaultDetectionConfig
from slave.gate import GateConfig
from slave.rigs import RigConfig
from slave.rigs.replayed import ReplayedRigConfig
from slave.rigs.simulated.simulated import SimulatedRigConfig, TendonPlantConfig
from slave.tendon_config import TendonConfig
from teleop.coupling import CouplingConfig, DirectConfig
from teleop.errors import UsageError
from teleop.messages import MAX_TENDONS
from teleop.run_config import require_periods

QUANTISED = math.sqrt(12.0)  # a step over the standard deviation that rounding to it adds

AS_BUILT = "as-built"

NO_FILES: model_files.ModelFiles = {}

DIRECT = DirectConfig()
USE_DIRECT = "they are felt with coupling: {type: direct}"


@dataclass(frozen=True, slots=True)
class SlaveConfig:
    """Everything the slave process needs."""

    rig: RigConfig = field(default_factory=SimulatedRigConfig)
    tendons: tuple[TendonConfig, ...] = ()  # one for each tendon of the rig, or one for all
    # in place of `tendons`: a file, or the numbers of a simulated rig as if perfectly calibrated
    calibration: Literal["as-built"] | Path | None = None
    initialise: InitialiseConfig = field(default_factory=InitialiseConfig)
    monitor: MonitorConfig = field(default_factory=MonitorConfig)
    control: ControlConfig = field(default_factory=ControlConfig)
    fault_detection: FaultDetectionConfig = field(default_factory=FaultDetectionConfig)
    gate: GateConfig = field(default_factory=GateConfig)
    command_timeout: float = (
        0.028  # [s] a command older than this makes the slave hold: < 30 ms in all
    )
    sample_timeout: float = 0.100  # [s] without a sample that can be used; longer is a fault

    def __post_init__(self) -> None:
        """Refuse two models, or a command that never grows old."""
        if self.tendons and self.calibration:
            raise ValueError("calibration: give either this or tendons")
        if self.calibration == AS_BUILT and not isinstance(self.rig, SimulatedRigConfig):
            raise ValueError("calibration: as-built is for simulated rigs")
        if self.control.tension_max >= self.gate.tension_max:
            raise ValueError(
                f"control.tension_max: must be below gate.tension_max ({self.gate.tension_max:g} N)"
            )
        if len(self.tendons) > MAX_TENDONS:
            raise ValueError(f"tendons: at most {MAX_TENDONS}")
        if not 0.0 < self.command_timeout <= 0.5 or not math.isfinite(self.command_timeout):
            raise ValueError("command_timeout: must be above 0 and at most 0.5 s")
        if not 0.0 < self.sample_timeout <= 1.0:
            raise ValueError("sample_timeout: must be above 0 and at most 1 s")

    def check_rate(self, rate_hz: float) -> None:
        """Refuse what does not go with the link's rate [Hz]; `UsageError`."""
        require_periods("slave.command_timeout", self.command_timeout, rate_hz)
        require_periods("slave.sample_timeout", self.sample_timeout, rate_hz)
        require_periods("slave.gate.tension_age_max", self.gate.tension_age_max, rate_hz)

    @property
    def rig_obeys(self) -> bool:
        """Whether the motors go where they are sent; those of data that are played have gone."""
        return not isinstance(self.rig, ReplayedRigConfig)


def tendon_configs(
    config: SlaveConfig,
    count: int,
    joints: JointTendons = (),
    files: model_files.ModelFiles = NO_FILES,
) -> tuple[TendonConfig, ...]:
    """Return the models for `count` tendons; `UsageError` if there are none, or too few.

    From the config, or from the calibration it names; model files replace what those say of the
    sheaths. Whether a calibration fits the rig is asked of `not_ready_reason`.
    """
    known: tuple[TendonConfig | None, ...] = (None,) * count
    if not files or config.tendons or config.calibration:
        known = _configured(config, count)
    found = tuple(
        tendon for tendon in model_files.apply(known, joints, files) if tendon is not None
    )
    if len(found) < count:
        raise UsageError(f"--model: not of every tendon, and slave.tendons: {UNCALIBRATED}")
    return found


def _configured(config: SlaveConfig, count: int) -> tuple[TendonConfig, ...]:
    tendons, place, remedy = config.tendons, "slave.tendons", "describe each, or one for all"
    if isinstance(config.calibration, Path):
        calibration = file.load(config.calibration)
        of = f"a calibration of the rig {calibration.rig!r}" if calibration.rig else "a calibration"
        tendons, place = calibration.tendons, f"{config.calibration}: {of}"
        remedy = "give the calibration of this rig, as `teleop calibrate` writes it"
    elif config.calibration == AS_BUILT and isinstance(config.rig, SimulatedRigConfig):
        joints = config.rig.joints
        tendons = tuple(
            as_built(t, joint.body.pretension) for joint in joints for t in joint.tendons
        )
    if not tendons:
        raise UsageError(f"slave.tendons: {UNCALIBRATED}")
    if len(tendons) == 1:
        return tendons * count
    if len(tendons) != count:
        raise UsageError(
            f"{place}: {len(tendons)} tendons described, the rig has {count}; {remedy}"
        )
    return tendons


UNCALIBRATED = (
    "the estimator has no model of these sheaths; set slave.calibration to the file that "
    "`teleop calibrate` writes, or that `teleop estimate DATA --fit --save FILE` does; of a "
    "simulated rig, as-built will do"
)


def not_ready_reason(config: SlaveConfig, rig: file.RigDescription, modelled: bool = False) -> str:
    """Return why this rig must not be used with this config's calibration; empty if it may.

    A rig that is `modelled` by model files needs none. Measured data that are played move nothing:
    unless its config gives the rig a name, they take the calibration of any.
    """
    if not isinstance(config.calibration, Path):
        return "" if config.tendons or config.calibration or modelled else UNCALIBRATED
    calibration = file.load(config.calibration)
    anonymous = isinstance(config.rig, ReplayedRigConfig) and not config.rig.name
    misfit = file.fits(calibration, rig, by_name=not anonymous)
    if misfit is None:
        return ""
    return f"{config.calibration.name} does not fit: {misfit}; run `teleop calibrate` on this rig"


def has_model_file(config: SlaveConfig) -> bool:
    """Return whether a tendon's sheath is that of a model file."""
    tendons = config.tendons
    if isinstance(config.calibration, Path):
        tendons = file.load(config.calibration).tendons
    return any(tendon.model_file is not None for tendon in tendons)


def config_warnings(config: SlaveConfig, coupling: CouplingConfig = DIRECT) -> list[str]:
    """Return what is to be said of calibration and coupling before anyone relies on them."""
    if not config.rig_obeys and not isinstance(coupling, DirectConfig):
        return [f"WARNING: coupling: data that are played fade in the hand; {USE_DIRECT}"]
    if any(tendon.tension_noise == 0.0 for tendon in config.tendons) and config.rig_obeys:
        return ["WARNING: slave.tendons: no tension_noise: a stuck load cell may not be noticed"]
    if not isinstance(config.calibration, Path):
        return []
    calibration = file.load(config.calibration)
    if calibration.accepted:
        return []
    return [f"WARNING: {config.calibration.name} is not accepted: {calibration.remark}"]


def as_built(tendon: TendonPlantConfig, pretension: float) -> TendonConfig:
    """Return what a perfect calibration of a simulated tendon would find; `pretension` in N."""
    step = tendon.encoder.resolution(tendon.motor.pulley_radius)
    return TendonConfig(
        friction=tendon.sheath.friction,
        sections=tendon.sheath.sections,
        axial_stiffness=tendon.sheath.axial_stiffness,
        pretension=pretension,
        tension_noise=math.hypot(tendon.load_cell.noise, tendon.load_cell.resolution / QUANTISED),
        displacement_noise=step / QUANTISED,
    )
