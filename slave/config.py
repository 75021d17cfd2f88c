"""The slave's section of a config file, and the models of its estimators."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from slave import model_files
from slave.adaptation import AdaptationConfig
from slave.calibration import calibration_file
from slave.calibration.calibration_file import JointTendons
from slave.calibration.config import InitialiseConfig
from slave.calibration.monitor import MonitorConfig
from slave.calibration.probing import ProbingConfig
from slave.control import ControlConfig
from slave.extensions import ControllerExtension, EstimatorExtension
from slave.fault_detection import FaultDetectionConfig
from slave.gate import GateConfig
from slave.rigs import RigConfig
from slave.rigs.hardware import HardwareRigConfig
from slave.rigs.replayed_data import ReplayedRigConfig
from slave.rigs.simulated import SimulatedRigConfig, TendonPlantConfig
from slave.sheath_section import SectionConfig
from slave.tendon_config import TendonConfig
from teleop.config.arm import ArmConfig
from teleop.config.ranges import build_bounds_warnings, build_ranged_field, check_ranges
from teleop.coupling import CouplingConfig, DirectConfig
from teleop.errors import UsageError
from teleop.messages.messages import MAX_TENDONS
from teleop.session.config import require_periods

# quantisation step over the standard deviation of its rounding error
QUANTISATION_FACTOR = math.sqrt(12.0)

AS_BUILT = "as-built"

NO_FILES: model_files.ModelFiles = {}

DIRECT = DirectConfig()


@dataclass(frozen=True, slots=True)
class SlaveConfig:
    """Settings of the slave process."""

    rig: RigConfig = field(default_factory=SimulatedRigConfig)  # motors and sensors at the housing
    tendons: tuple[TendonConfig, ...] = ()  # one for each tendon of the rig, or one for all
    # instead of `tendons`: a file, or as-built, the true parameters of a simulated rig
    calibration: Literal["as-built"] | Path | None = None
    initialise: InitialiseConfig = field(default_factory=InitialiseConfig)
    monitor: MonitorConfig = field(default_factory=MonitorConfig)
    adaptation: AdaptationConfig = field(default_factory=AdaptationConfig)
    probing: ProbingConfig = field(default_factory=ProbingConfig)
    control: ControlConfig = field(default_factory=ControlConfig)
    estimator: EstimatorExtension | None = None  # of another package; null = the built-in one
    controller: ControllerExtension | None = None  # of another package; null = the built-in one
    fault_detection: FaultDetectionConfig = field(default_factory=FaultDetectionConfig)
    gate: GateConfig = field(default_factory=GateConfig)
    # [s] a command older than this makes the slave hold: < 30 ms in all
    command_timeout: float = build_ranged_field(0.028, 0.0, 0.5, "s", above=True)
    # without a usable sample; longer is a fault
    sample_timeout: float = build_ranged_field(0.100, 0.0, 1.0, "s", above=True)

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.tendons and self.calibration:
            raise ValueError("calibration: conflicts with tendons; use one of them")
        if self.calibration == AS_BUILT and not isinstance(self.rig, SimulatedRigConfig):
            raise ValueError("calibration: as-built is only for simulated rigs")
        if self.control.tension_max >= self.gate.tension_max:
            raise ValueError(
                f"control.tension_max: must be below gate.tension_max ({self.gate.tension_max:g} N)"
            )
        if self.adaptation.enabled and self.estimator is not None:
            raise ValueError("adaptation: is of the built-in estimator; leave out estimator")
        if (
            self.adaptation.enabled
            and isinstance(self.rig, ReplayedRigConfig)
            and len(self.rig.tendons) > 1
        ):
            raise ValueError(
                "adaptation: data of several tendons do not tell which are pairs; replay one"
            )
        if len(self.tendons) > MAX_TENDONS:
            raise ValueError(f"tendons: at most {MAX_TENDONS}")

    def check_rate(self, rate_hz: float) -> None:
        """Check the timeouts against the link's rate [Hz]; `UsageError`."""
        require_periods("slave.command_timeout", self.command_timeout, rate_hz)
        require_periods("slave.sample_timeout", self.sample_timeout, rate_hz)
        require_periods("slave.gate.tension_age_max", self.gate.tension_age_max, rate_hz)

    def check_arms(self, arms: tuple[ArmConfig, ...]) -> None:
        """Check what arms with shared tendons cannot have; `UsageError`."""
        if self.adaptation.enabled and arms:
            raise UsageError(
                "slave.adaptation.enabled: must be false with arms, whose joints share tendons; "
                "calibrate them again when a sheath has moved"
            )
        if self.initialise.at_start and any(arm.has_tendon_rows for arm in arms):
            raise UsageError(
                "slave.initialise.at_start: must be false where arms.radii has a row for each "
                "tendon; give slave.tendons instead"
            )

    @property
    def is_actuated(self) -> bool:
        """Whether the motors follow commands; False for replayed data."""
        return not isinstance(self.rig, ReplayedRigConfig)


def load_tendon_configs(
    config: SlaveConfig,
    count: int,
    joints: JointTendons = (),
    files: model_files.ModelFiles = NO_FILES,
) -> tuple[TendonConfig, ...]:
    """Return the models of `count` tendons; `UsageError` if there are none, or too few.

    From the config or the calibration it names; model files replace their sheath parameters.
    `find_not_ready_reason` checks whether the calibration fits the rig.
    """
    known: tuple[TendonConfig | None, ...] = (None,) * count
    if not files or config.tendons or config.calibration:
        known = _load_configured_tendons(config, count)
    found = tuple(
        tendon
        for tendon in model_files.apply_model_files(known, joints, files)
        if tendon is not None
    )
    if len(found) < count:
        raise UsageError(f"--model: missing for some tendons, and slave.tendons: {UNCALIBRATED}")
    return found


def _load_configured_tendons(config: SlaveConfig, count: int) -> tuple[TendonConfig, ...]:
    tendons, place, remedy = config.tendons, "slave.tendons", "describe each, or one for all"
    if isinstance(config.calibration, Path):
        calibration = calibration_file.load(config.calibration)
        of = f"a calibration of the rig {calibration.rig!r}" if calibration.rig else "a calibration"
        tendons, place = calibration.tendons, f"{config.calibration}: {of}"
        remedy = "give the calibration of this rig, as `teleop calibrate` writes it"
    elif config.calibration == AS_BUILT and isinstance(config.rig, SimulatedRigConfig):
        pulls = [pull for row in config.rig.list_pretensions() for pull in row]
        plants = [tendon for joint in config.rig.joints for tendon in joint.tendons]
        lengths = config.rig.list_arm_lengths()
        tendons = tuple(map(to_tendon_config, plants, pulls, lengths))
    if not tendons:
        raise UsageError(f"slave.tendons: {UNCALIBRATED}")
    if len(tendons) == 1:
        return tendons * count
    if len(tendons) != count:
        raise UsageError(f"{place}: {len(tendons)} tendons, but the rig has {count}; {remedy}")
    return tendons


def load_arms(config: SlaveConfig, arms: tuple[ArmConfig, ...]) -> tuple[ArmConfig, ...]:
    """Return the arms, with the friction at passed joints of the calibration, if it has any."""
    if not isinstance(config.calibration, Path):
        return arms
    return calibration_file.apply_guide_friction(
        arms, calibration_file.load(config.calibration).guides
    )


UNCALIBRATED = (
    "the sheaths have no model; set slave.calibration to a file written by `teleop calibrate` or "
    "`teleop estimate DATA --fit --save FILE`, or to as-built for a simulated rig"
)


def find_not_ready_reason(
    config: SlaveConfig, rig: calibration_file.RigDescription, modelled: bool = False
) -> str:
    """Return why this rig must not be used with this config's calibration; empty if it may be.

    With model files (`modelled`) no calibration is needed. Replayed data accept the calibration of
    any rig unless the config names one.
    """
    if not isinstance(config.calibration, Path):
        return "" if config.tendons or config.calibration or modelled else UNCALIBRATED
    calibration = calibration_file.load(config.calibration)
    anonymous = isinstance(config.rig, ReplayedRigConfig) and not config.rig.name
    misfit = calibration_file.find_misfit(calibration, rig, by_name=not anonymous)
    if misfit is None:
        return ""
    return f"{config.calibration.name} does not fit: {misfit}; run `teleop calibrate` on this rig"


def has_model_file(config: SlaveConfig) -> bool:
    """Return whether a tendon uses a model file."""
    tendons = config.tendons
    if isinstance(config.calibration, Path):
        tendons = calibration_file.load(config.calibration).tendons
    return any(tendon.model_file is not None for tendon in tendons)


def find_config_warnings(config: SlaveConfig, coupling: CouplingConfig = DIRECT) -> list[str]:
    """Return warnings about limits, calibration and coupling."""
    return [
        *build_bounds_warnings("slave.gate", config.gate),
        *_find_model_warnings(config, coupling),
        *_find_loop_warnings(config),
    ]


def _find_model_warnings(config: SlaveConfig, coupling: CouplingConfig) -> list[str]:
    if not config.is_actuated and not isinstance(coupling, DirectConfig):
        text = "replayed forces fade at the master with this coupling"
        return [f"WARNING: coupling: {text}; use coupling: {{type: direct}}"]
    if any(tendon.tension_noise == 0.0 for tendon in config.tendons) and config.is_actuated:
        return ["WARNING: slave.tendons: no tension_noise: a stuck load cell may not be noticed"]
    if not isinstance(config.calibration, Path):
        return []
    calibration = calibration_file.load(config.calibration)
    if calibration.accepted:
        return []
    return [f"WARNING: {config.calibration.name} is not accepted: {calibration.remark}"]


def _find_loop_warnings(config: SlaveConfig) -> list[str]:
    """Return a warning for each sensing loop that has only one of cells and `loop_friction`."""
    if not isinstance(config.rig, SimulatedRigConfig | HardwareRigConfig):
        return []
    models = config.tendons
    if isinstance(config.calibration, Path):
        models = calibration_file.load(config.calibration).tendons
    loops = [bool(tendon.loop) for joint in config.rig.joints for tendon in joint.tendons]
    if len(models) == 1:
        models *= len(loops)
    lines = []
    for number, (has_loop, model) in enumerate(zip(loops, models, strict=False), 1):
        if has_loop and model.loop_friction == 0.0:
            lines.append(f"tendon {number} has a sensing loop, not used without loop_friction")
        elif model.loop_friction > 0.0 and not has_loop:
            lines.append(f"tendon {number} has loop_friction, but the rig measures no loop there")
    return [f"WARNING: slave.tendons: {line}" for line in lines]


def to_tendon_config(
    tendon: TendonPlantConfig, pretension: float, arm_length: float = 0.0
) -> TendonConfig:
    """Return the true parameters of a simulated tendon as a config.

    `pretension` [N], `arm_length` [m] of it in an arm, behind its sheath.
    """
    step, loop = tendon.encoder.compute_resolution(tendon.motor.pulley_radius), tendon.loop
    bend = sum(section.length / section.radius for section in tendon.sheath.sections)
    in_arm = (SectionConfig(arm_length),) if arm_length > 0.0 else ()
    return TendonConfig(
        friction=tendon.sheath.friction,
        sections=(*tendon.sheath.sections, *in_arm),
        axial_stiffness=tendon.sheath.axial_stiffness,
        pretension=pretension,
        tension_noise=math.hypot(
            tendon.load_cell.noise, tendon.load_cell.resolution / QUANTISATION_FACTOR
        ),
        displacement_noise=step / QUANTISATION_FACTOR,
        loop_friction=0.0 if loop is None else 2.0 * loop.friction * bend,
    )
