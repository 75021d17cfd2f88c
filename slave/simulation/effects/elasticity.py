"""Effects in the elasticity, length, shape and integrity of a tendon and its sheath."""

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from slave.simulation.effects.effect import TendonEffect
from slave.simulation.effects.ends import SideEffect
from slave.simulation.joint import Tendon
from slave.simulation.tendon import TendonDeviations
from teleop.config.ranges import build_ranged_field


@dataclass(frozen=True, slots=True)
class NonlinearStiffness(TendonEffect):
    """Toe region of the elasticity: strain T/EA + strain (1 - exp(-T / tension))."""

    type: Literal["nonlinear_stiffness"] = "nonlinear_stiffness"
    strain: float = build_ranged_field(1e-3, 0.0, 0.02)  # of the toe region
    tension: float = build_ranged_field(2.0, 0.1, 100.0, "N")  # scale of the toe region
    adds_up: ClassVar[bool] = False

    def apply(
        self, deviations: TendonDeviations, _time: float, _slid: float, /
    ) -> TendonDeviations:
        return deviations._replace(toe_strain=self.strain, toe_tension=self.tension)


@dataclass(frozen=True, slots=True)
class Creep(TendonEffect):
    """Creep of the tendon under tension: a standard linear solid."""

    type: Literal["creep"] = "creep"
    share: float = build_ranged_field(0.1, 0.0, 2.0)  # final creep over elastic elongation
    time_constant: float = build_ranged_field(8.0, 0.01, 1e4, "s")  # of the creep
    adds_up: ClassVar[bool] = False

    def apply(
        self, deviations: TendonDeviations, _time: float, _slid: float, /
    ) -> TendonDeviations:
        return deviations._replace(creep_share=self.share, creep_time=self.time_constant)


@dataclass(frozen=True, slots=True)
class SheathCompression(TendonEffect):
    """A sheath compressed above a threshold, with higher friction there.

    Elongation: compression (T - threshold)^2 if T were the tension all along; friction:
    (1 + friction_rise (T - threshold)).
    """

    type: Literal["sheath_compression"] = "sheath_compression"
    compression: float = build_ranged_field(1e-6, 0.0, 1e-4, "m/N^2")  # of the whole sheath
    threshold: float = build_ranged_field(5.0, 0.0, 100.0, "N")  # tension at which it begins
    friction_rise: float = build_ranged_field(0.0, 0.0, 0.1, "1/N")  # relative, above the threshold
    adds_up: ClassVar[bool] = False

    def apply(
        self, deviations: TendonDeviations, _time: float, _slid: float, /
    ) -> TendonDeviations:
        return deviations._replace(
            compression=self.compression,
            compression_threshold=self.threshold,
            compression_friction=self.friction_rise,
        )


@dataclass(frozen=True, slots=True)
class Slack(TendonEffect):
    """Excess tendon length, wound in before any tension builds up."""

    type: Literal["slack"] = "slack"
    length: float = build_ranged_field(1e-3, 0.0, 0.05, "m")  # of tendon in excess

    def apply(
        self, deviations: TendonDeviations, _time: float, _slid: float, /
    ) -> TendonDeviations:
        return deviations._replace(slack=deviations.slack + self.length)


@dataclass(frozen=True, slots=True)
class ThermalExpansion(TendonEffect):
    """Thermal expansion of the tendon relative to its sheath."""

    type: Literal["thermal_expansion"] = "thermal_expansion"
    # of tendon over sheath; steel: 1.2e-5
    coefficient: float = build_ranged_field(1.2e-5, -1e-4, 1e-3, "1/K")
    warming: float = build_ranged_field(10.0, -100.0, 100.0, "K")  # in the end
    time_constant: float = build_ranged_field(60.0, 0.01, 1e5, "s")  # of the warming
    varies: ClassVar[bool] = True

    def apply(self, deviations: TendonDeviations, time: float, _slid: float, /) -> TendonDeviations:
        warming = self.warming * -math.expm1(-time / self.time_constant)
        return deviations._replace(expansion=deviations.expansion + self.coefficient * warming)


# --- effects along the sheath: where its bends lie, and damage at a place

BREAK_GAP = 0.3  # [m] between the ends of a broken tendon: more than a motor can close
JAMMED_CELLS = 6  # cells that hold a jammed tendon: a tension ratio of 7^6, still within rounding
JAM_FRICTION = 1.5  # friction of each, which transmits a seventh


@dataclass(frozen=True, slots=True)
class NonuniformCurvature(SideEffect):
    """The same total bend, redistributed: `ratio` times as sharp at the tip as at the housing.

    The curvature is weighted by a factor that grows exponentially along the sheath.
    """

    type: Literal["nonuniform_curvature"] = "nonuniform_curvature"
    # curvature at the tip over that at the housing
    ratio: float = build_ranged_field(4.5, 0.05, 20.0)

    def change(self, tendon: Tendon, /) -> Tendon:
        friction = tendon.chain.friction
        total = friction.sum()
        if total == 0.0:
            return tendon
        weighted = friction * np.geomspace(1.0, self.ratio, len(friction))
        weighted *= total / weighted.sum()
        return tendon._replace(chain=tendon.chain._replace(friction=weighted))


@dataclass(frozen=True, slots=True)
class BrokenTendon(SideEffect):
    """The tendon breaks at a fraction of its length from the housing."""

    type: Literal["broken_tendon"] = "broken_tendon"
    share: float = build_ranged_field(0.5, 0.0, 1.0)  # of the length, from the housing

    def change(self, tendon: Tendon, /) -> Tendon:
        parted = tendon.chain.parted.copy()
        parted[round(self.share * (len(parted) - 1))] = BREAK_GAP
        return tendon._replace(chain=tendon.chain._replace(parted=parted))


@dataclass(frozen=True, slots=True)
class JammedTendon(SideEffect):
    """The tendon jams in its sheath at a fraction of its length from the housing.

    By friction that no motor overcomes, given a tension on the housing's side.
    """

    type: Literal["jammed_tendon"] = "jammed_tendon"
    share: float = build_ranged_field(0.5, 0.0, 1.0)  # of the length, from the housing

    def change(self, tendon: Tendon, /) -> Tendon:
        friction = tendon.chain.friction.copy()
        first = round(self.share * max(0, len(friction) - JAMMED_CELLS))
        friction[first : first + JAMMED_CELLS] = JAM_FRICTION
        return tendon._replace(chain=tendon.chain._replace(friction=friction))


ElasticityEffect = (
    NonlinearStiffness | Creep | SheathCompression | Slack | ThermalExpansion | NonuniformCurvature
)

FailureEffect = BrokenTendon | JammedTendon
