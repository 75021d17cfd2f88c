"""What the estimator is told about one tendon."""

import math
from dataclasses import dataclass, field
from typing import Literal

from estimator import noise_treatment
from estimator.effects.effect import Effect, Values
from estimator.law.sheath import Sheath
from estimator.law.tables import MAX_SECTIONS
from estimator.online.extended_model import Extension
from estimator.online.reading_correction import MAX_CORRECTIONS


class ModelError(ValueError):
    """A tendon model that cannot be; the message names the field, the value and what is allowed."""


@dataclass(frozen=True, slots=True)
class TendonModel:
    """What the estimator is told about one tendon.

    Attributes
    ----------
    sheath
        Geometry, friction and stiffness, of at most `tables.MAX_SECTIONS` sections.
    tension_noise, displacement_noise
        Standard deviations of the white noise of T_in [N] and q_p [m], from a record at rest by
        `signals.estimate_noise_sigma`. Quantisation by d counts as d/sqrt(12).
    initial
        "slack", or the tension [N] along a tendon that has not slid since it was pretensioned.
    treatment
        How the tension is made fit to drive the profile.
    friction_error
        Relative error of K the interval allows for.
    elongation_error
        Relative error of the predicted elongation (of EA, mostly) the decisions allow for.
    tip_tension_rate
        How fast T_out may change unseen [N/s]; ``math.inf`` trusts only what moves right now.
    extension
        What a diagnosis found beyond the law of the sheath, if anything; of its corrections of
        readings, at most `reading_correction.MAX_CORRECTIONS`.
    loop_friction
        ln of the tension ratio over a sensing loop in the tube (`estimator.sensing_loop_friction`)
        while K is that of `sheath`; 0 without one.
    tip_effects
        Effects, with their values, of a bench's load cell at the tip; only errors go by them.
    """

    sheath: Sheath
    tension_noise: float = 0.0  # [N]
    displacement_noise: float = 0.0  # [m]
    initial: Literal["slack"] | float = "slack"  # [N]
    treatment: noise_treatment.Treatment = field(default_factory=noise_treatment.Treatment)
    friction_error: float = 0.02
    elongation_error: float = 0.1
    tip_tension_rate: float = 100.0  # [N/s]
    loop_friction: float = 0.0
    extension: Extension | None = None
    tip_effects: tuple[tuple[Effect, Values], ...] = ()

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        sections = len(self.sheath.sections)
        if sections > MAX_SECTIONS:
            raise ModelError(f"sheath: {sections} sections, at most {MAX_SECTIONS} are possible")
        corrections = 0 if self.extension is None else len(self.extension.readings)
        if corrections > MAX_CORRECTIONS:
            raise ModelError(
                f"extension: {corrections} corrections of readings, at most {MAX_CORRECTIONS} are "
                "possible"
            )
        for name in ("tension_noise", "displacement_noise", "friction_error", "loop_friction"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ModelError(f"{name}: {getattr(self, name)}, must be finite and not negative")
        if not 0.0 <= self.elongation_error < 1.0:
            raise ModelError(f"elongation_error: {self.elongation_error}, allowed are 0 to 1")
        if not self.tip_tension_rate >= 0.0:
            raise ModelError(f"tip_tension_rate: {self.tip_tension_rate} N/s, must not be negative")
        if isinstance(self.initial, str):
            is_valid = self.initial == "slack"
        else:
            is_valid = 0.0 <= self.initial < math.inf
        if not is_valid:
            raise ModelError(f'initial: {self.initial!r}, allowed are "slack" or a tension [N]')
