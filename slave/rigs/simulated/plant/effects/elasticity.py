"""Effects in the elasticity and length of a tendon and its sheath."""

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

from slave.rigs.simulated.plant.effects.effect import TendonEffect, build_ranged_field
from slave.rigs.simulated.plant.knobs import Knobs


@dataclass(frozen=True, slots=True)
class NonlinearStiffness(TendonEffect):
    """Toe region of the elasticity: strain T/EA + strain (1 - exp(-T / tension))."""

    type: Literal["nonlinear_stiffness"] = "nonlinear_stiffness"
    strain: float = build_ranged_field(1e-3, 0.0, 0.02)
    tension: float = build_ranged_field(2.0, 0.1, 100.0, "N")
    adds_up: ClassVar[bool] = False

    def apply(self, knobs: Knobs, _time: float, _slid: float, /) -> Knobs:
        """Return the knobs with this effect added."""
        return knobs._replace(toe_strain=self.strain, toe_tension=self.tension)


@dataclass(frozen=True, slots=True)
class Creep(TendonEffect):
    """Creep of the tendon under tension: a standard linear solid."""

    type: Literal["creep"] = "creep"
    share: float = build_ranged_field(0.1, 0.0, 2.0)  # final creep over elastic elongation
    time_constant: float = build_ranged_field(8.0, 0.01, 1e4, "s")
    adds_up: ClassVar[bool] = False

    def apply(self, knobs: Knobs, _time: float, _slid: float, /) -> Knobs:
        """Return the knobs with this effect added."""
        return knobs._replace(creep_share=self.share, creep_time=self.time_constant)


@dataclass(frozen=True, slots=True)
class SheathCompression(TendonEffect):
    """A sheath compressed above a threshold, with higher friction there.

    Elongation: compression (T - threshold)^2 if T were the tension all along; friction:
    (1 + friction_rise (T - threshold)).
    """

    type: Literal["sheath_compression"] = "sheath_compression"
    compression: float = build_ranged_field(1e-6, 0.0, 1e-4, "m/N^2")
    threshold: float = build_ranged_field(5.0, 0.0, 100.0, "N")
    friction_rise: float = build_ranged_field(0.0, 0.0, 0.1, "1/N")
    adds_up: ClassVar[bool] = False

    def apply(self, knobs: Knobs, _time: float, _slid: float, /) -> Knobs:
        """Return the knobs with this effect added."""
        return knobs._replace(
            compression=self.compression,
            compression_threshold=self.threshold,
            compression_friction=self.friction_rise,
        )


@dataclass(frozen=True, slots=True)
class Slack(TendonEffect):
    """Excess tendon length, wound in before any tension builds up."""

    type: Literal["slack"] = "slack"
    length: float = build_ranged_field(1e-3, 0.0, 0.05, "m")

    def apply(self, knobs: Knobs, _time: float, _slid: float, /) -> Knobs:
        """Return the knobs with this effect added."""
        return knobs._replace(slack=knobs.slack + self.length)


@dataclass(frozen=True, slots=True)
class ThermalExpansion(TendonEffect):
    """Thermal expansion of the tendon relative to its sheath."""

    type: Literal["thermal_expansion"] = "thermal_expansion"
    coefficient: float = build_ranged_field(
        1.2e-5, -1e-4, 1e-3, "1/K"
    )  # of tendon over sheath; steel: 1.2e-5
    warming: float = build_ranged_field(10.0, -100.0, 100.0, "K")  # in the end
    time_constant: float = build_ranged_field(60.0, 0.01, 1e5, "s")
    varies: ClassVar[bool] = True

    def apply(self, knobs: Knobs, time: float, _slid: float, /) -> Knobs:
        """Return the knobs with this effect added."""
        warming = self.warming * -math.expm1(-time / self.time_constant)
        return knobs._replace(expansion=knobs.expansion + self.coefficient * warming)
