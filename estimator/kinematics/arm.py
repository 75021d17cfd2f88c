"""An arm: a chain of joints and curved sections from its base to its tip.

Each part is reached from the one before by a fixed offset. A curved section is an arc of constant
curvature that starts along the z axis of its frame; its coordinates are the bend as a vector
(towards which the tip bends, times the angle), which has no singularity where it is straight, and
its elongation where it has one.

`Arm` is what people write and read, `prepare_arm` makes of it the record of the compiled functions.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Annotated, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.structs import I64, Field, Struct, StructArray, view_struct

MAX_COORDINATES = 8
"""Coordinates of an arm: as many as a message has joints."""

MAX_PARTS = 32
"""Parts of an arm, with those that are fixed."""

FIXED, REVOLUTE, PRISMATIC, CURVED = range(4)
"""Kinds of parts in a `PreparedArm`."""

_KINDS = {"fixed": FIXED, "revolute": REVOLUTE, "continuous": REVOLUTE, "prismatic": PRISMATIC}
_BEND_MAX = 4.0 * math.pi  # [rad] twice round, which no section does


class ArmError(ValueError):
    """An arm that cannot exist or be read; the message names the part and the remedy."""


@dataclass(frozen=True)
class Offset:
    """Position and orientation of a frame in the frame before it, as the `origin` of URDF.

    Attributes
    ----------
    position
        [m].
    rpy
        Roll, pitch, yaw [rad]: rotations about x, y and z of the frame before, in this order.
    """

    position: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m]
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [rad]

    def __post_init__(self) -> None:
        for name, numbers in (("position", self.position), ("rpy", self.rpy)):
            if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
                raise ArmError(f"offset {name}: {numbers}, must be three finite numbers")

    def to_matrix(self) -> Array:
        """Return the homogeneous matrix, shape (4, 4)."""
        (cr, cp, cy), (sr, sp, sy) = np.cos(self.rpy), np.sin(self.rpy)
        rotation = [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
        matrix = np.eye(4)
        matrix[:3, :3] = rotation
        matrix[:3, 3] = self.position
        return matrix


class Coordinate(NamedTuple):
    """One coordinate of an arm and its limits."""

    name: str
    is_linear: bool  # [m], [m/s], [N]; otherwise [rad], [rad/s], [N m]
    lower: float
    upper: float
    speed: float
    effort: float


@dataclass(frozen=True)
class Joint:
    """A joint, or a fixed frame.

    Attributes
    ----------
    name
        As in messages and figures.
    kind
        "continuous" is a revolute joint without limits of position.
    axis
        In its own frame, of any length.
    offset
        Of the joint's frame at its zero, in the frame of the part before.
    lower, upper
        Limits of position [rad] or [m].
    speed, effort
        Limits of speed [rad/s] or [m/s], of torque [N m] or force [N].
    mass, centre
        Of the link that it moves [kg], and its centre of mass [m] in the frame of the joint.
    inertia
        About that centre, in the directions of that frame [kg m^2]: xx, xy, xz, yy, yz, zz.
    """

    name: str
    kind: Literal["revolute", "continuous", "prismatic", "fixed"] = "revolute"
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    offset: Offset = field(default_factory=Offset)
    lower: float = -math.inf
    upper: float = math.inf
    speed: float = math.inf
    effort: float = math.inf
    mass: float = 0.0
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    inertia: tuple[float, float, float, float, float, float] = (0.0,) * 6

    def __post_init__(self) -> None:
        if not (0.0 <= self.mass < math.inf and all(map(math.isfinite, self.centre))):
            raise ArmError(f"joint {self.name}: mass {self.mass:g} kg at {self.centre}, not finite")
        if not (
            all(map(math.isfinite, self.inertia))
            and np.linalg.eigvalsh(self.to_inertia_matrix()).min()
            >= -1e-6 * max(map(abs, self.inertia))
        ):
            raise ArmError(
                f"joint {self.name}: inertia {self.inertia} kg m^2 of the link that it moves, must "
                "be finite and negative about no axis"
            )
        if self.kind not in _KINDS:
            raise ArmError(
                f"joint {self.name}: kind {self.kind!r}, allowed are {', '.join(_KINDS)}"
            )
        if self.kind == "fixed":
            return
        length = math.hypot(*self.axis)
        if len(self.axis) != 3 or not 1e-9 < length < math.inf:
            raise ArmError(f"joint {self.name}: axis {self.axis}, must be three numbers, not all 0")
        if self.kind == "continuous":
            if self.lower > -math.inf or self.upper < math.inf:
                raise ArmError(f"joint {self.name}: limits of position; make it revolute")
        elif not -math.inf < self.lower < self.upper < math.inf:
            raise ArmError(
                f"joint {self.name}: limits {self.lower:g} to {self.upper:g}; "
                f"a {self.kind} joint needs lower and upper limit, lower below upper"
            )
        _require_positive(f"joint {self.name}", speed=self.speed, effort=self.effort)

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """One coordinate, or none if it is fixed."""
        if self.kind == "fixed":
            return ()
        linear = self.kind == "prismatic"
        limits = (self.lower, self.upper, self.speed, self.effort)
        return (Coordinate(self.name, linear, *limits),)

    def to_inertia_matrix(self) -> Array:
        """Return the inertia of the link that it moves [kg m^2], shape (3, 3)."""
        xx, xy, xz, yy, yz, zz = self.inertia
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@dataclass(frozen=True)
class CurvedSection:
    """A section of constant curvature, which starts along the z axis of its frame.

    Attributes
    ----------
    name
        Its coordinates are `name.x`, `name.y` and, where it has one, `name.length`.
    length
        Arc length [m] at no elongation.
    bend_max
        Largest bend towards ±x and towards ±y [rad].
    offset
        Of its frame, in the frame of the part before.
    bend_speed, bend_effort
        Limits of each bend's speed [rad/s] and torque [N m].
    elongation
        Lowest and highest change of length [m]; None for a section of constant length.
    elongation_speed, elongation_effort
        Limits of its speed [m/s] and force [N].
    mass
        [kg], spread evenly along its middle line.
    """

    name: str
    length: float  # [m]
    bend_max: float  # [rad]
    offset: Offset = field(default_factory=Offset)
    bend_speed: float = math.inf  # [rad/s]
    bend_effort: float = math.inf  # [N m]
    elongation: tuple[float, float] | None = None  # [m]
    elongation_speed: float = math.inf  # [m/s]
    elongation_effort: float = math.inf  # [N]
    mass: float = 0.0  # [kg]

    def __post_init__(self) -> None:
        place = f"section {self.name}"
        if not 0.0 < self.length < math.inf:
            raise ArmError(f"{place}: length {self.length} m, must be positive and finite")
        if not 0.0 < self.bend_max <= _BEND_MAX:
            raise ArmError(
                f"{place}: bend_max {self.bend_max} rad, must be above 0 and at most 4 pi"
            )
        if self.elongation is not None:
            low, high = self.elongation
            if not -self.length < low < high < math.inf:
                raise ArmError(
                    f"{place}: elongation {low:g} to {high:g} m, must rise and leave some of the "
                    f"length of {self.length:g} m"
                )
        _require_positive(
            place,
            bend_speed=self.bend_speed,
            bend_effort=self.bend_effort,
            elongation_speed=self.elongation_speed,
            elongation_effort=self.elongation_effort,
        )

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Two bends [rad], and the elongation [m] where it has one."""
        bend = (False, -self.bend_max, self.bend_max, self.bend_speed, self.bend_effort)
        bends = tuple(Coordinate(f"{self.name}.{axis}", *bend) for axis in "xy")
        if self.elongation is None:
            return bends
        limits = (*self.elongation, self.elongation_speed, self.elongation_effort)
        return (*bends, Coordinate(f"{self.name}.length", True, *limits))


@dataclass(frozen=True)
class Arm:
    """A chain of parts from the base to the tip.

    Attributes
    ----------
    parts
        From the base on, of at most `MAX_COORDINATES` coordinates.
    tip
        Of the tip in the frame of the last part: at the far end of a curved section.
    """

    parts: tuple[Joint | CurvedSection, ...]
    tip: Offset = field(default_factory=Offset)

    def __post_init__(self) -> None:
        count = len(self.coordinates)
        if not 1 <= count <= MAX_COORDINATES:
            raise ArmError(
                f"arm: {count} coordinates, allowed are 1 to {MAX_COORDINATES}; "
                "choose another base or tip, or make joints fixed"
            )
        if len(self.parts) > MAX_PARTS:
            raise ArmError(
                f"arm: {len(self.parts)} parts, at most {MAX_PARTS} are possible; join fixed ones"
            )
        for name, following in pairwise(sorted(part.name for part in self.parts)):
            if name == following:
                raise ArmError(f"arm: two parts are named {name!r}; give each its own name")

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The coordinates from the base on."""
        return tuple(coordinate for part in self.parts for coordinate in part.coordinates)


def _require_positive(place: str, **limits: float) -> None:
    for name, limit in limits.items():
        if not limit > 0.0:
            raise ArmError(f"{place}: {name} limit {limit:g}, must be positive")


# --- an arm made ready for compiled functions, as a record

Coordinates = Annotated[Array, Field("f8", MAX_COORDINATES)]
"""A field with one number per coordinate, zero beyond them."""


class PreparedArm(Struct):
    """An `Arm` as compiled functions know it."""

    parts: I64  # how many are in use
    coordinates: I64  # how many are in use
    kind: Annotated[NDArray[np.int64], Field("i8", MAX_PARTS)]
    first: Annotated[NDArray[np.int64], Field("i8", MAX_PARTS)]  # coordinate of the part
    extends: Annotated[NDArray[np.int64], Field("i8", MAX_PARTS)]  # has an elongation
    offset: Annotated[Array, Field("f8", (MAX_PARTS, 4, 4))]
    axis: Annotated[Array, Field("f8", (MAX_PARTS, 3))]  # unit length
    length: Annotated[Array, Field("f8", MAX_PARTS)]  # [m] of a curved section
    mass: Annotated[Array, Field("f8", MAX_PARTS)]  # [kg] of the link behind the part
    centre: Annotated[Array, Field("f8", (MAX_PARTS, 3))]  # [m] of that mass
    tip: Annotated[Array, Field("f8", (4, 4))]
    is_linear: Annotated[NDArray[np.int64], Field("i8", MAX_COORDINATES)]
    lower: Coordinates
    upper: Coordinates
    speed: Coordinates
    effort: Coordinates


def prepare_arm(arm: Arm) -> StructArray:
    """Return the record of `arm` for the compiled functions, as an array of one."""
    records = PreparedArm.array()
    prepared: PreparedArm = view_struct(records)
    coordinates = arm.coordinates
    prepared.parts, prepared.coordinates = len(arm.parts), len(coordinates)
    prepared.tip[:] = arm.tip.to_matrix()
    for i, (part, first) in enumerate(_number_parts(arm)):
        prepared.first[i] = first
        prepared.offset[i] = part.offset.to_matrix()
        if isinstance(part, CurvedSection):
            prepared.kind[i] = CURVED
            prepared.length[i] = part.length
            prepared.extends[i] = part.elongation is not None
        else:
            prepared.kind[i] = _KINDS[part.kind]
            prepared.mass[i], prepared.centre[i] = part.mass, part.centre
            prepared.axis[i] = np.array(part.axis) / (math.hypot(*part.axis) or 1.0)
    for name in ("is_linear", "lower", "upper", "speed", "effort"):
        getattr(prepared, name)[: len(coordinates)] = [getattr(c, name) for c in coordinates]
    return records


def _number_parts(arm: Arm) -> Iterator[tuple[Joint | CurvedSection, int]]:
    """Yield each part with the number of its first coordinate."""
    first = 0
    for part in arm.parts:
        yield part, first
        first += len(part.coordinates)
