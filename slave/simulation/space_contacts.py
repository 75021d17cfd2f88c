"""What turns all joints of an arm in space: surfaces that its tip meets.

Within a step the tip moves as the links' velocities at the start of the step say, and a surface is
its tangent plane there; its force pushes along the normal and never pulls.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.small_arrays import copy_values
from slave.simulation.environment import STIFFNESS_MAX
from slave.simulation.link_inertia import LinkMotion
from teleop.config.arm import LinkedArmConfig
from teleop.config.ranges import RangedConfig, build_ranged_field, check_ranges

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class PlaneConfig:
    """A flat surface: F = stiffness d + damping d' at depth d."""

    type: Literal["plane"] = "plane"
    point: Vector = (0.0, 0.0, 0.05)  # [m] on the surface
    normal: Vector = (0.0, 0.0, -1.0)  # out of it, towards the tip, of any length
    stiffness: float = build_ranged_field(1000.0, 0.0, STIFFNESS_MAX, "N/m")  # of the surface
    damping: float = build_ranged_field(0.0, 0.0, 1e4, "N s/m")  # on the way in

    def __post_init__(self) -> None:
        check_ranges(self)
        if not 1e-9 < math.hypot(*self.normal) < math.inf:
            raise ValueError("normal: must be three numbers, not all 0")


@dataclass(frozen=True, slots=True)
class BallConfig(RangedConfig):
    """A ball of tissue: F = stiffness d^1.5 + damping d' at depth d, Hertz's contact."""

    type: Literal["ball"] = "ball"
    centre: Vector = (0.0, 0.0, 0.09)  # [m] of the ball
    radius: float = build_ranged_field(0.02, 1e-4, 1.0, "m")  # of the ball
    stiffness: float = build_ranged_field(9_400.0, 0.0, 1e9, "N/m^1.5")  # of the contact
    damping: float = build_ranged_field(0.0, 0.0, 1e4, "N s/m")  # on the way in


SurfaceConfig = PlaneConfig | BallConfig

PLANE, BALL = range(2)


class SpaceContacts(NamedTuple):
    """The surfaces that the arms of a rig meet."""

    joints: NDArray[np.int64]  # first joint of its arm, and that behind its last, shape (m, 2)
    # shape (m, 11): kind, point or centre, normal, radius, stiffness, exponent, damping
    surfaces: Array


def build_space_contacts(
    arms: Sequence[tuple[LinkedArmConfig, Sequence[SurfaceConfig]]],
) -> SpaceContacts:
    """Return the surfaces of arms, each with what its tip meets."""
    joints: list[tuple[int, int]] = []
    rows: list[list[float]] = []
    first = 0
    for config, surfaces in arms:
        joints += [(first, first + config.joints)] * len(surfaces)
        rows += map(_to_row, surfaces)
        first += config.joints
    return SpaceContacts(
        np.array(joints, np.int64).reshape(-1, 2), np.array(rows, np.float64).reshape(-1, 11)
    )


def _to_row(surface: SurfaceConfig) -> list[float]:
    law = (surface.stiffness, 1.0, surface.damping)
    if isinstance(surface, PlaneConfig):
        normal = np.array(surface.normal) / math.hypot(*surface.normal)
        return [PLANE, *surface.point, *normal.tolist(), 0.0, *law]
    return [BALL, *surface.centre, 0.0, 0.0, 0.0, surface.radius, law[0], 1.5, law[2]]


@jit_compile
def locate_surfaces(contacts: SpaceContacts, motion: LinkMotion) -> tuple[Array, Array]:
    """Return the depth [m] of the tips in each surface, and its slopes over the joints' travels.

    The depth, shape (m,), is negative outside; the slopes have shape (m, n).
    """
    count = len(contacts.surfaces)
    depth, slope = np.empty(count), np.zeros((count, len(motion.mass)))
    for i in range(count):
        surface, (first, last) = contacts.surfaces[i], contacts.joints[i]
        tip, normal = motion.tips[first], surface[4:7].copy()
        away = tip - surface[1:4]  # from the point or the centre to the tip
        if surface[0] == BALL:
            distance = math.sqrt(away[0] ** 2 + away[1] ** 2 + away[2] ** 2)
            copy_values(away / max(distance, 1e-12), normal)
        depth[i] = surface[7] - (normal[0] * away[0] + normal[1] * away[1] + normal[2] * away[2])
        for j in range(first, last):
            velocity, turning = motion.columns[0, j], motion.columns[1, j]
            for k in range(3):
                u, v = (k + 1) % 3, (k + 2) % 3
                speed = velocity[k] + turning[u] * tip[v] - turning[v] * tip[u]
                slope[i, j] -= normal[k] * speed
    return depth, slope


@jit_compile
def press_surface(surface: Array, depth: float, before: float, dt: float) -> tuple[float, float]:
    """Return the force [N] of a surface at `depth` [m], `dt` [s] after `before`, and its slope."""
    if depth <= 0.0:
        return 0.0, 0.0
    stiffness, exponent, damping = surface[8], surface[9], surface[10]
    rate = (depth - max(before, 0.0)) / dt
    force, slope = stiffness * depth**exponent, stiffness * exponent * depth ** (exponent - 1.0)
    if rate > 0.0:
        return force + damping * rate, slope + damping / dt
    return force, slope
