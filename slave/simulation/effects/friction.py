"""Effects in the friction of a tendon on its sheath."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from slave.simulation.effects.effect import TendonEffect
from slave.simulation.tendon import TendonDeviations
from teleop.config.ranges import build_ranged_field


@dataclass(frozen=True, slots=True)
class FrictionStep(TendonEffect):
    """A change of the sheath's shape: a step of all friction by one factor."""

    type: Literal["friction_step"] = "friction_step"
    change: float = build_ranged_field(0.25, -0.95, 5.0)  # relative

    def apply(
        self, deviations: TendonDeviations, _time: float, _slid: float, /
    ) -> TendonDeviations:
        return deviations._replace(friction_scale=deviations.friction_scale * (1.0 + self.change))


@dataclass(frozen=True, slots=True)
class FrictionDrift(TendonEffect):
    """Wear, lubricant or temperature: friction changes with time or with the distance slid."""

    type: Literal["friction_drift"] = "friction_drift"
    per_second: float = build_ranged_field(0.0, -1.0, 1.0, "1/s")  # relative
    per_metre: float = build_ranged_field(0.0, -10.0, 10.0, "1/m")  # relative
    limit: float = build_ranged_field(0.5, 0.0, 5.0)  # of the relative change
    varies: ClassVar[bool] = True

    def __post_init__(self) -> None:
        TendonEffect.__post_init__(self)
        if self.per_second == 0.0 and self.per_metre == 0.0:
            raise ValueError("per_second: set this or per_metre")

    def apply(self, deviations: TendonDeviations, time: float, slid: float, /) -> TendonDeviations:
        change = self.per_second * time + self.per_metre * slid
        change = max(-min(self.limit, 1.0), min(self.limit, change))
        return deviations._replace(friction_scale=deviations.friction_scale * (1.0 + change))


@dataclass(frozen=True, slots=True)
class ConstantDrag(TendonEffect):
    """Load-independent friction, from seals or bending stiffness: an offset of the tension."""

    type: Literal["constant_drag"] = "constant_drag"
    drag: float = build_ranged_field(0.6, 0.0, 10.0, "N")  # tau

    def apply(
        self, deviations: TendonDeviations, _time: float, _slid: float, /
    ) -> TendonDeviations:
        return deviations._replace(drag=deviations.drag + self.drag)


@dataclass(frozen=True, slots=True)
class ViscousFriction(TendonEffect):
    """Viscous friction along the whole sheath, as from grease."""

    type: Literal["viscous_friction"] = "viscous_friction"
    viscosity: float = build_ranged_field(50.0, 0.0, 5000.0, "N s/m^2")  # per metre of sheath

    def apply(
        self, deviations: TendonDeviations, _time: float, _slid: float, /
    ) -> TendonDeviations:
        return deviations._replace(viscosity=deviations.viscosity + self.viscosity)


@dataclass(frozen=True, slots=True)
class StribeckFriction(TendonEffect):
    """Stribeck friction: higher near standstill.

    friction * (1 + ratio exp(-(v / speed)^2)), with v delayed by `memory`; with a short memory a
    tendon on a soft tip shows stick-slip.
    """

    type: Literal["stribeck_friction"] = "stribeck_friction"
    # friction at rest over that at speed, less one
    ratio: float = build_ranged_field(0.25, 0.0, 2.0)
    speed: float = build_ranged_field(1e-3, 1e-5, 1.0, "m/s")  # scale of its decay
    memory: float = build_ranged_field(0.2, 1e-3, 10.0, "s")  # time constant of the speed
    adds_up: ClassVar[bool] = False

    def apply(
        self, deviations: TendonDeviations, _time: float, _slid: float, /
    ) -> TendonDeviations:
        return deviations._replace(
            stribeck_ratio=self.ratio, stribeck_speed=self.speed, stribeck_memory=self.memory
        )


@dataclass(frozen=True, slots=True)
class Presliding(TendonEffect):
    """Presliding: contacts yield elastically before they slide, in proportion to their friction."""

    type: Literal["presliding"] = "presliding"
    distance: float = build_ranged_field(5e-5, 1e-6, 1e-3, "m")  # elastic yield of a contact
    # at which a contact yields by that much
    tension: float = build_ranged_field(10.0, 0.1, 100.0, "N")
    adds_up: ClassVar[bool] = False

    def apply(
        self, deviations: TendonDeviations, _time: float, _slid: float, /
    ) -> TendonDeviations:
        return deviations._replace(presliding=self.distance, presliding_tension=self.tension)


@dataclass(frozen=True, slots=True)
class DirectionAsymmetry(TendonEffect):
    """Direction-dependent friction, from laid strands or coils."""

    type: Literal["direction_asymmetry"] = "direction_asymmetry"
    # rho, towards the tip over towards the housing
    ratio: float = build_ranged_field(0.8, 0.3, 3.0)

    def apply(
        self, deviations: TendonDeviations, _time: float, _slid: float, /
    ) -> TendonDeviations:
        return deviations._replace(asymmetry=deviations.asymmetry * self.ratio)


@dataclass(frozen=True, slots=True)
class TensionDependentFriction(TendonEffect):
    """Friction force ~ T^exponent: the coefficient times (T / reference)^(exponent - 1)."""

    type: Literal["tension_dependent_friction"] = "tension_dependent_friction"
    exponent: float = build_ranged_field(0.85, 0.5, 1.5)  # of the tension
    reference: float = build_ranged_field(10.0, 0.1, 100.0, "N")  # tension without change
    adds_up: ClassVar[bool] = False

    def apply(
        self, deviations: TendonDeviations, _time: float, _slid: float, /
    ) -> TendonDeviations:
        return deviations._replace(tension_exponent=self.exponent, tension_reference=self.reference)


@dataclass(frozen=True, slots=True)
class StickSlip(TendonEffect):
    """Static friction that grows at rest and decays with sliding: stick-slip at low speed.

    Above about distance / rest_time a contact slides smoothly.
    """

    type: Literal["stick_slip"] = "stick_slip"
    # static over sliding friction, after long rest
    ratio: float = build_ranged_field(1.3, 1.0, 3.0)
    rest_time: float = build_ranged_field(0.5, 1e-3, 100.0, "s")  # time constant of growth at rest
    distance: float = build_ranged_field(2e-5, 1e-7, 1e-3, "m")  # slid while it decays
    adds_up: ClassVar[bool] = False

    def apply(
        self, deviations: TendonDeviations, _time: float, _slid: float, /
    ) -> TendonDeviations:
        return deviations._replace(
            static_ratio=self.ratio, static_time=self.rest_time, static_distance=self.distance
        )


FrictionEffect = (
    FrictionStep
    | FrictionDrift
    | ConstantDrag
    | ViscousFriction
    | StribeckFriction
    | Presliding
    | DirectionAsymmetry
    | TensionDependentFriction
    | StickSlip
)
