"""Geometry and material of one tendon in its sheath."""

import math
from dataclasses import dataclass
from typing import Self

MAX_K = 20.0
"""Largest friction coordinate accepted: at e^-20 nothing measurable reaches the tip."""

ASSUMED_COMPLIANCE = 1e-4
"""L/EA [m/N] of a sheath of which only tensions were measured, which do not tell it."""


class SheathError(ValueError):
    """A sheath that cannot exist; the message names the field, the value and what is allowed."""


@dataclass(frozen=True)
class Section:
    """A stretch of sheath of constant curvature.

    Attributes
    ----------
    length
        Arc length [m], positive.
    radius
        Bend radius [m], positive; ``math.inf`` for a straight stretch.
    """

    length: float  # [m]
    radius: float = math.inf  # [m]

    def __post_init__(self) -> None:
        if not (0.0 < self.length < math.inf):
            raise SheathError(f"section length: {self.length} m, must be positive and finite")
        if not self.radius > 0.0:
            raise SheathError(f"section radius: {self.radius} m, must be positive (inf: straight)")

    @property
    def bend_angle(self) -> float:
        """Angle the section turns through [rad]."""
        return self.length / self.radius


@dataclass(frozen=True)
class Sheath:
    """A tendon in its sheath, in sections from the motor to the tip.

    Attributes
    ----------
    sections
        At least one, proximal first.
    friction
        Coulomb coefficient mu between tendon and sheath, not negative.
    axial_stiffness
        EA [N], tendon and sheath in series: 1/EA = 1/(EA)_tendon + 1/(EA)_sheath. The paper writes
        E for it; it is a force, not a modulus.
    drag
        tau [N], friction that does not depend on tension, as the tension that would cause it:
        dT/dx = ∓(mu/R)(T + tau) (docs/explanation/theory.md, section 8). A drag f_0 per length is
        tau = f_0 L/K.
    asymmetry
        rho, friction while sliding towards the tip over friction while sliding towards the motor.
    """

    sections: tuple[Section, ...]
    friction: float
    axial_stiffness: float  # [N]
    drag: float = 0.0  # [N]
    asymmetry: float = 1.0

    def __post_init__(self) -> None:
        if not self.sections:
            raise SheathError("sheath sections: none given, at least one is needed")
        if not (0.0 <= self.friction < math.inf):
            raise SheathError(f"sheath friction: {self.friction}, must be finite and not negative")
        if not (0.0 < self.axial_stiffness < math.inf):
            raise SheathError(
                f"sheath axial_stiffness: {self.axial_stiffness} N, must be positive and finite"
            )
        if not (0.0 <= self.drag < math.inf):
            raise SheathError(f"sheath drag: {self.drag} N, must be finite and not negative")
        if not (0.0 < self.asymmetry < math.inf):
            raise SheathError(f"sheath asymmetry: {self.asymmetry}, must be positive and finite")
        if not self.K * max(1.0, self.asymmetry) <= MAX_K:
            raise SheathError(
                f"sheath K: {self.K:.4g} with asymmetry {self.asymmetry:.4g}, "
                f"their product must not exceed {MAX_K:g}"
            )

    @classmethod
    def uniform(
        cls,
        K: float,
        length: float,
        axial_stiffness: float,
        *,
        friction: float = 0.1,
        drag: float = 0.0,
        asymmetry: float = 1.0,
    ) -> Self:
        """Return the sheath of constant curvature that has friction coordinate `K` at its tip.

        Tip force and elongation depend on `K`, `length` [m] and `axial_stiffness` [N] alone;
        `friction` only decides which bend radius friction · length / K stands behind them.
        """
        if not (0.0 <= K < math.inf):
            raise SheathError(f"sheath K: {K}, must be finite and not negative")
        if K > 0.0 and not friction > 0.0:
            raise SheathError(f"sheath friction: {friction}, must be positive when K > 0")
        radius = friction * length / K if K > 0.0 else math.inf
        return cls((Section(length, radius),), friction, axial_stiffness, drag, asymmetry)

    @property
    def length(self) -> float:
        """Total arc length L [m]."""
        return math.fsum(section.length for section in self.sections)

    @property
    def bend_angle(self) -> float:
        """Total bend angle theta(L) [rad]; bends add up, whatever plane they lie in."""
        return math.fsum(section.bend_angle for section in self.sections)

    @property
    def K(self) -> float:  # noqa: N802 (the paper's symbol)
        """Friction coordinate of the tip, mu theta(L): the paper's effective friction, eq. (4)."""
        return self.friction * self.bend_angle
