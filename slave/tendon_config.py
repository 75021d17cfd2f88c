"""Config of one tendon and its sheath, also in calibration files."""

from dataclasses import dataclass, fields
from pathlib import Path

from estimator.law.sheath import Section, Sheath, SheathError
from estimator.online import extended_model
from estimator.online.extended_model import ExtendedModel
from estimator.online.online import TendonModel
from slave.sheath_section import SectionConfig
from teleop.data import model_file
from teleop.errors import UsageError
from teleop.messages.messages import MAX_MESSAGE_SECTIONS

_IN_MODEL_FILE = ("effective_friction", "friction", "sections", "drag", "asymmetry")
"""Fields that a model file replaces."""


@dataclass(frozen=True, slots=True)
class TendonConfig:
    """Parameters of one tendon and its sheath for the estimator.

    Either the effective friction K of the whole sheath, from a calibration, or a friction
    coefficient with sections, or the model file of a diagnosis.
    """

    effective_friction: float | None = None  # K, dimensionless
    length: float = 1.5  # [m] with effective_friction; else from the sections
    friction: float | None = None  # mu, dimensionless
    sections: tuple[SectionConfig, ...] = ()  # housing to tip
    # EA [N] of tendon and sheath in series; model_file takes precedence
    axial_stiffness: float = 9000.0
    drag: float = 0.0  # tau [N], load-independent
    asymmetry: float = 1.0  # rho, friction releasing over friction pulling
    pretension: float = 0.0  # [N] uniform tension at the start; 0 = slack
    tension_noise: float = 0.0  # [N] standard deviation at the load cell
    displacement_noise: float = 0.0  # [m] standard deviation at the encoder
    friction_error: float = 0.02  # relative error of K covered by the interval
    elongation_error: float = 0.1  # relative error of the elongation covered by the interval
    tip_tension_rate: float = 100.0  # [N/s] largest unobserved rate of the tip tension
    # ln of the tension ratio over a sensing loop in the tube, as K was calibrated; 0 = none
    loop_friction: float = 0.0
    model_file: Path | None = None  # model.yaml of `teleop diagnose`, replaces all of the sheath

    def __post_init__(self) -> None:
        if self.model_file is not None:
            self._refuse_beside_model_file()
        elif (self.effective_friction is None) == (self.friction is None):
            raise ValueError("effective_friction: set either this or friction with sections")
        if (self.friction is None) != (not self.sections):
            raise ValueError("sections: required with friction, and only with it")
        if len(self.sections) > MAX_MESSAGE_SECTIONS:
            raise ValueError(f"sections: at most {MAX_MESSAGE_SECTIONS}")
        self.build_model()

    def _refuse_beside_model_file(self) -> None:
        for item in fields(self):
            if item.name in _IN_MODEL_FILE and getattr(self, item.name) != item.default:
                raise ValueError(f"{item.name}: conflicts with model_file; use one of them")

    def load_extended_model(self) -> ExtendedModel | None:
        """Return the extended model of the model file, None without one."""
        if self.model_file is None:
            return None
        model, duration, *_ = model_file.load(self.model_file)
        try:
            return extended_model.build_extended_model(
                model.shared, model.effects, duration, self.length, self.axial_stiffness
            )
        except SheathError as error:
            raise UsageError(f"{self.model_file}: {error}") from error

    def build_model(self) -> TendonModel:
        """Return the estimator's model of this tendon."""
        extended = self.load_extended_model()
        if extended is not None:
            sheath = extended.sheath
        elif self.effective_friction is not None:
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
            loop_friction=self.loop_friction,
            extension=None if extended is None else extended.extension,
            tip_effects=() if extended is None else extended.tip_effects,
        )
