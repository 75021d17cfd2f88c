"""Virtual fixtures: walls, planes, a guiding line and cushions, as springs that store their energy.

Each is a potential U of the tip's position or of the coordinates, and its force is -dU. Brought to
the joints as torques and from there to the hand by the velocity map, a fixture gives back on a
closed path what it took. A spring of stiffness k that is pressed in by d has

    U = k d^2 / 2 up to the force F, and F d - F^2 / (2 k) beyond: its force never exceeds F.

The cushion of singularities has U = U_0 (1 - (s / s_1)^2)^2 where the smallest singular value s of
the weighted Jacobian is below s_1; smooth also where s is zero.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.kinematics.arm import MAX_COORDINATES, ArmError, PreparedArm
from estimator.kinematics.forward import write_kinematics
from estimator.kinematics.inverse import (
    InverseSettings,
    decompose_weighted_jacobian,
    write_weighted_jacobian,
)
from estimator.structs import F64, I64, Field, Flag, Struct, StructArray, view_struct

MAX_PLANES = 8

_DIFFERENCE = 1e-5  # [rad] of the Jacobian's derivative: error 1e-10, of second order


@dataclass(frozen=True, slots=True)
class Plane:
    """A plane that the tip is kept on one side of."""

    point: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m] on the plane
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)  # to where the tip may be, of any length


@dataclass(frozen=True, slots=True)
class Guide:
    """A line that the tip is drawn to."""

    point: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m] on the line
    direction: tuple[float, float, float] = (1.0, 0.0, 0.0)  # along it, of any length
    width: float = 0.0  # [m] distance that is free


@dataclass(frozen=True, slots=True)
class FixturesConfig:
    """The fixtures of an arm, all in the frame of its base."""

    box: tuple[tuple[float, float], ...] = ()  # [m] from, to of x, y, z; inf = open
    planes: tuple[Plane, ...] = ()  # that the tip is kept on one side of
    guide: Guide | None = None  # line that the tip is drawn to
    stiffness: float = 300.0  # [N/m] of box, planes and guide
    force_max: float = 3.0  # [N] of each box side, plane, and the guide
    limit_margin: float = 0.0  # [rad] before joint limits, [m] times rotation_length; 0 = none
    limit_stiffness: float = 0.5  # [N m/rad] of the cushions before joint limits
    singular_value: float = 0.0  # [m] s_1 below which a singular posture is cushioned; 0 = none
    singular_energy: float = 0.01  # [J] U_0 of that cushion, at the singular posture

    def __post_init__(self) -> None:
        """Check the values; raises `ArmError`."""
        if len(self.box) not in (0, 3) or not all(low < high for low, high in self.box):
            raise ArmError("box: three pairs [from, to] in metres, from below to")
        if len(self.planes) > MAX_PLANES:
            raise ArmError(f"planes: {len(self.planes)}, at most {MAX_PLANES} are possible")
        directions = [("planes: normal", plane.normal) for plane in self.planes]
        if self.guide is not None:
            directions.append(("guide: direction", self.guide.direction))
            if not 0.0 <= self.guide.width < math.inf:
                raise ArmError(f"guide: width {self.guide.width} m, must not be negative")
        for place, direction in directions:
            if len(direction) != 3 or not 1e-9 < math.hypot(*direction) < math.inf:
                raise ArmError(f"{place} {direction}, must be three numbers, not all 0")
        for name in ("stiffness", "force_max", "limit_stiffness"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ArmError(f"{name}: {getattr(self, name)}, must be positive and finite")
        for name in ("limit_margin", "singular_value", "singular_energy"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ArmError(f"{name}: {getattr(self, name)}, must be finite and not negative")


class Fixtures(Struct):
    """A `FixturesConfig` as a record, and where it is evaluated."""

    low: Annotated[Array, Field("f8", 3, fill=-math.inf)]  # [m]
    high: Annotated[Array, Field("f8", 3, fill=math.inf)]
    planes: I64
    normal: Annotated[Array, Field("f8", (MAX_PLANES, 3))]  # unit length
    distance: Annotated[Array, Field("f8", MAX_PLANES)]  # [m] of the plane, along its normal
    has_guide: Flag
    guide_point: Annotated[Array, Field("f8", 3)]
    guide_direction: Annotated[Array, Field("f8", 3)]  # unit length
    guide_width: F64
    stiffness: F64
    force_max: F64
    limit_margin: F64
    limit_stiffness: F64
    singular_value: F64
    singular_energy: F64

    columns: Annotated[NDArray[np.int64], Field("i8", MAX_COORDINATES)]
    weighted: Annotated[Array, Field("f8", (6, MAX_COORDINATES))]
    changed: Annotated[Array, Field("f8", (6, MAX_COORDINATES))]
    gram: Annotated[Array, Field("f8", (MAX_COORDINATES, MAX_COORDINATES))]
    vectors: Annotated[Array, Field("f8", (MAX_COORDINATES, MAX_COORDINATES))]
    left: Annotated[Array, Field("f8", MAX_COORDINATES)]
    right: Annotated[Array, Field("f8", MAX_COORDINATES)]
    q: Annotated[Array, Field("f8", MAX_COORDINATES)]
    pose: Annotated[Array, Field("f8", (4, 4))]
    jacobian: Annotated[Array, Field("f8", (6, MAX_COORDINATES))]


def build_fixtures(config: FixturesConfig) -> StructArray:
    """Return the record of a config as an array of one."""
    records = Fixtures.array()
    fixtures: Fixtures = view_struct(records)
    for axis, (low, high) in enumerate(config.box):
        fixtures.low[axis], fixtures.high[axis] = low, high
    fixtures.planes = len(config.planes)
    for i, plane in enumerate(config.planes):
        fixtures.normal[i] = np.array(plane.normal) / math.hypot(*plane.normal)
        fixtures.distance[i] = fixtures.normal[i] @ np.array(plane.point)
    if config.guide is not None:
        fixtures.has_guide = True
        fixtures.guide_point[:] = config.guide.point
        direction = np.array(config.guide.direction)
        fixtures.guide_direction[:] = direction / math.hypot(*config.guide.direction)
        fixtures.guide_width = config.guide.width
    for name in _SCALARS:
        setattr(fixtures, name, getattr(config, name))
    return records


_SCALARS = (
    *("stiffness", "force_max", "limit_margin", "limit_stiffness"),
    *("singular_value", "singular_energy"),
)


@jit_compile
def write_fixture_torque(
    fixtures: Fixtures,
    arm: PreparedArm,
    settings: InverseSettings,
    q: Array,
    pose: Array,
    jacobian: Array,
    torque: Array,
) -> float:
    """Write what all fixtures exert on the coordinates, -dU/dq; return U [J].

    Parameters
    ----------
    settings : InverseSettings
        Weights of the singular values, and the unit of linear coordinates.
    q : array, shape (n,) or longer
        Coordinates.
    pose, jacobian : array, shape (4, 4) and (6, n) or wider
        Of the tip at `q`, from `forward.write_kinematics`.
    torque : array, shape (n,) or longer
        [N m] or [N].
    """
    force_x, force_y, force_z, energy = compute_tip_force(
        fixtures, pose[0, 3], pose[1, 3], pose[2, 3]
    )
    for j in range(arm.coordinates):
        torque[j] = force_x * jacobian[0, j] + force_y * jacobian[1, j] + force_z * jacobian[2, j]
    if fixtures.limit_margin > 0.0:
        energy += _add_limit_torque(fixtures, arm, settings, q, torque)
    if fixtures.singular_value > 0.0:
        energy += _add_singularity_torque(fixtures, arm, settings, q, jacobian, torque)
    return energy


@jit_compile
def compute_tip_force(
    fixtures: Fixtures, x: float, y: float, z: float
) -> tuple[float, float, float, float]:
    """Return the force [N] of box, planes and guide at a position of the tip [m], and U [J]."""
    position = (x, y, z)
    fx, fy, fz, energy = 0.0, 0.0, 0.0, 0.0
    stiffness, force_max = fixtures.stiffness, fixtures.force_max
    for axis in range(3):
        above = max(position[axis] - fixtures.high[axis], 0.0)
        below = max(fixtures.low[axis] - position[axis], 0.0)
        push_down, energy_above = _press_spring(above, stiffness, force_max)
        push_up, energy_below = _press_spring(below, stiffness, force_max)
        energy += energy_above + energy_below
        if axis == 0:
            fx += push_up - push_down
        elif axis == 1:
            fy += push_up - push_down
        else:
            fz += push_up - push_down
    for i in range(fixtures.planes):
        normal = fixtures.normal[i]
        height = normal[0] * x + normal[1] * y + normal[2] * z - fixtures.distance[i]
        push, stored = _press_spring(max(-height, 0.0), stiffness, force_max)
        energy += stored
        fx, fy, fz = fx + push * normal[0], fy + push * normal[1], fz + push * normal[2]
    if fixtures.has_guide:
        point, line = fixtures.guide_point, fixtures.guide_direction
        dx, dy, dz = x - point[0], y - point[1], z - point[2]
        along = dx * line[0] + dy * line[1] + dz * line[2]
        dx, dy, dz = dx - along * line[0], dy - along * line[1], dz - along * line[2]
        distance = math.sqrt(dx * dx + dy * dy + dz * dz)
        depth = max(distance - fixtures.guide_width, 0.0)
        pull, stored = _press_spring(depth, stiffness, force_max)
        energy += stored
        if pull > 0.0:
            pull /= distance
            fx, fy, fz = fx - pull * dx, fy - pull * dy, fz - pull * dz
    return fx, fy, fz, energy


@jit_compile
def _press_spring(depth: float, stiffness: float, force_max: float) -> tuple[float, float]:
    """Return the force of a spring pressed in by `depth`, at most `most`, and its energy."""
    force = stiffness * depth
    if force <= force_max:
        return force, 0.5 * force * depth
    return force_max, force_max * depth - 0.5 * force_max * force_max / stiffness


@jit_compile
def _add_limit_torque(
    fixtures: Fixtures, arm: PreparedArm, settings: InverseSettings, q: Array, torque: Array
) -> float:
    """Add the springs before the limits of position; return their energy [J]."""
    energy = 0.0
    for j in range(arm.coordinates):
        unit = settings.rotation_length if arm.is_linear[j] else 1.0
        margin = fixtures.limit_margin * unit
        stiffness = fixtures.limit_stiffness / (unit * unit)
        above = max(q[j] - arm.upper[j] + margin, 0.0)
        below = max(arm.lower[j] + margin - q[j], 0.0)
        torque[j] += stiffness * (below - above)
        energy += 0.5 * stiffness * (above * above + below * below)
    return energy


@jit_compile
def _add_singularity_torque(
    fixtures: Fixtures,
    arm: PreparedArm,
    settings: InverseSettings,
    q: Array,
    jacobian: Array,
    torque: Array,
) -> float:
    """Add the cushion of singularities; return its energy [J].

    s^2 is an eigenvalue of A^T A with the vector v, so that d(s^2) = 2 (A v)^T dA v, dA by central
    differences of the Jacobian.
    """
    n, columns, weighted = arm.coordinates, fixtures.columns, fixtures.weighted
    for j in range(n):
        columns[j], fixtures.q[j] = j, q[j]
    rows = write_weighted_jacobian(arm, settings, jacobian, columns, n, weighted)
    decompose_weighted_jacobian(weighted, rows, n, fixtures.gram, fixtures.vectors)
    smallest = 0
    for k in range(min(rows, n)):
        if fixtures.gram[k, k] < fixtures.gram[smallest, smallest]:
            smallest = k
    square = fixtures.singular_value * fixtures.singular_value
    excess = 1.0 - max(fixtures.gram[smallest, smallest], 0.0) / square
    if excess <= 0.0:
        return 0.0
    left, right, vectors = fixtures.left, fixtures.right, fixtures.vectors
    for row in range(rows):
        left[row] = vectors[row, smallest] if n > rows else 0.0
    for j in range(n):
        right[j] = 0.0 if n > rows else vectors[j, smallest]
    for row in range(rows):
        for j in range(n):
            if n > rows:
                right[j] += weighted[row, j] * left[row]
            else:
                left[row] += weighted[row, j] * right[j]
    gain = 2.0 * fixtures.singular_energy * excess / square
    for j in range(n):
        unit = settings.rotation_length if arm.is_linear[j] else 1.0
        difference = 0.0
        for side in (1.0, -1.0):
            fixtures.q[j] = q[j] + side * _DIFFERENCE * unit
            write_kinematics(arm, fixtures.q, fixtures.pose, fixtures.jacobian)
            write_weighted_jacobian(arm, settings, fixtures.jacobian, columns, n, fixtures.changed)
            for row in range(rows):
                for k in range(n):
                    difference += side * left[row] * fixtures.changed[row, k] * right[k]
        fixtures.q[j] = q[j]
        torque[j] += gain * difference / (_DIFFERENCE * unit)
    return float(fixtures.singular_energy * excess * excess)
