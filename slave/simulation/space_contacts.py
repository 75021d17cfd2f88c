"""What turns all joints of an arm in space: surfaces that its tip meets.

Within a step the tip moves as its Jacobian at the start of the step says, and a surface is its
tangent plane there; its force pushes along the normal and never pulls.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.arrays import copy_values
from estimator.compiled import jit_compile
from estimator.kinematics.arm import PreparedArm, prepare_arm
from estimator.kinematics.forward import write_kinematics
from estimator.records import StructArray
from slave.simulation.environment import STIFFNESS_MAX
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
    """The surfaces that the arms of a rig meet, and the arms' kinematics."""

    arms: StructArray  # PreparedArm, shape (arms,)
    first: Array  # first joint of each arm, shape (arms,)
    radius: Array  # [m] of all joints' own pulleys, shape (joints,)
    # one row per surface: arm, kind, point or centre, normal, radius, stiffness, exponent, damping
    surfaces: Array


def build_space_contacts(
    arms: Sequence[tuple[LinkedArmConfig, Sequence[SurfaceConfig]]], radius: Array
) -> SpaceContacts:
    """Return the surfaces of arms, each with what its tip meets.

    `radius` [m] are the joints' own pulleys, shape (joints,); `UsageError` if an arm's kinematics
    cannot be read.
    """
    prepared, first = [PreparedArm.array()], [0]
    rows: list[list[float]] = []
    joint = 0
    for config, surfaces in arms:
        if surfaces:
            prepared.append(prepare_arm(config.load_kinematics()))
            first.append(joint)
        rows += [_to_row(len(prepared) - 1, surface) for surface in surfaces]
        joint += config.joints
    table = np.array(rows).reshape(-1, 12)
    firsts = np.array(first, np.float64)
    return SpaceContacts(np.concatenate(prepared), firsts, radius, table)


def _to_row(arm: int, surface: SurfaceConfig) -> list[float]:
    law = (surface.stiffness, 1.0, surface.damping)
    if isinstance(surface, PlaneConfig):
        normal = np.array(surface.normal) / math.hypot(*surface.normal)
        return [arm, PLANE, *surface.point, *normal.tolist(), 0.0, *law]
    return [arm, BALL, *surface.centre, 0.0, 0.0, 0.0, surface.radius, law[0], 1.5, law[2]]


@jit_compile
def locate_surfaces(contacts: SpaceContacts, travel: Array) -> tuple[Array, Array]:
    """Return the depth [m] of the tips in each surface, and its slopes over the joints' travels.

    Parameters
    ----------
    travel : array, shape (n,)
        Of the joints [m].

    Returns
    -------
    depth : array, shape (m,)
        Negative outside.
    slope : array, shape (m, n)
        Dimensionless.
    """
    count, n = len(contacts.surfaces), len(travel)
    depth, slope = np.empty(count), np.zeros((count, n))
    pose, jacobian = np.empty((4, 4)), np.empty((6, n))
    angle, at = np.empty(n), -1
    for i in range(count):
        surface = contacts.surfaces[i]
        which = int(surface[0])
        arm, first = contacts.arms[which], int(contacts.first[which])
        if which != at:
            for j in range(arm.coordinates):
                angle[j] = travel[first + j] / contacts.radius[first + j]
            write_kinematics(arm, angle, pose, jacobian)
            at = which
        normal = surface[5:8].copy()
        away = pose[:3, 3] - surface[2:5]  # from the point or the centre to the tip
        if surface[1] == BALL:
            distance = math.sqrt(away[0] ** 2 + away[1] ** 2 + away[2] ** 2)
            copy_values(away / max(distance, 1e-12), normal)
        depth[i] = surface[8] - (normal[0] * away[0] + normal[1] * away[1] + normal[2] * away[2])
        for j in range(arm.coordinates):
            along = (
                normal[0] * jacobian[0, j] + normal[1] * jacobian[1, j] + normal[2] * jacobian[2, j]
            )
            slope[i, first + j] = -along / contacts.radius[first + j]
    return depth, slope


@jit_compile
def press_surface(surface: Array, depth: float, before: float, dt: float) -> tuple[float, float]:
    """Return the force [N] of a surface at `depth` [m], `dt` [s] after `before`, and its slope."""
    if depth <= 0.0:
        return 0.0, 0.0
    stiffness, exponent, damping = surface[9], surface[10], surface[11]
    rate = (depth - max(before, 0.0)) / dt
    force, slope = stiffness * depth**exponent, stiffness * exponent * depth ** (exponent - 1.0)
    if rate > 0.0:
        return force + damping * rate, slope + damping / dt
    return force, slope
