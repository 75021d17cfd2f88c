"""The joints of an arm and the tendons that they share, as every process knows them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estimator.array_types import Array
from estimator.kinematics.arm import Arm, ArmError, CurvedSection, Offset
from estimator.kinematics.urdf import URDF_BYTES_MAX, read_arm
from teleop.errors import UsageError
from teleop.runtime.files import read_small_file

RADIUS_MIN, RADIUS_MAX = 1e-4, 1.0  # [m]
CONDITION_MAX = 1e4  # of the matrix of travels: beyond it joints cannot be told apart


def load_arm(path: str | Path, *, tip: str, base: str | None = None) -> Arm:
    """Return the chain of joints between two links of a URDF file.

    Parameters
    ----------
    path
        The file, of at most 5 MB; xacro is to be expanded before.
    tip, base
        Names of the links that are the tip and the base; the base is the root if None.

    Raises
    ------
    UsageError
        The file cannot be read, or holds no such arm; one line with place and remedy.
    """
    try:
        return read_arm(
            read_small_file(Path(path), URDF_BYTES_MAX), tip=tip, base=base, source=str(path)
        )
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror or error}") from None
    except ArmError as error:
        raise UsageError(str(error)) from None


@dataclass(frozen=True, slots=True)
class RoutingConfig:
    """How tendons pass the joints of an arm.

    Row k of `radii` belongs to the tendons of joint k, of one or of a pair; column j to joint j.
    The tendons of joint k travel by the sum of radii[k][j] times the angle of joint j.
    """

    # [m] signed pulley radii; the diagonal is a joint's own pulley
    radii: tuple[tuple[float, ...], ...] = ((0.005,),)
    # mu of tendons at the joints that they pass: one, or one a joint
    friction: float | tuple[float, ...] = 0.1
    wrap: float = 0.0  # [rad] of a tendon at each of them while the joint is straight

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        if not self.radii or any(len(row) != len(self.radii) for row in self.radii):
            raise ValueError("radii: must be square: a row and a column for each joint")
        radii = np.array(self.radii)
        if not (abs(radii) <= RADIUS_MAX).all():
            raise ValueError(f"radii: must be -{RADIUS_MAX:g} to {RADIUS_MAX:g} m")
        own = abs(np.diag(radii))
        if not (own >= RADIUS_MIN).all():
            raise ValueError(
                f"radii: joint {own.argmin() + 1}: its own tendons must turn it, by a radius of at "
                f"least {RADIUS_MIN:g} m (the diagonal)"
            )
        if not np.linalg.cond(radii / own) <= CONDITION_MAX:
            raise ValueError("radii: these tendons do not determine all joints (singular matrix)")
        if not all(0.0 <= mu <= 1.0 for mu in self.list_friction()):
            raise ValueError("friction: must be 0 to 1")
        if len(self.list_friction()) != len(self.radii):
            raise ValueError(f"friction: must be one number, or {len(self.radii)}: one a joint")
        if not 0.0 <= self.wrap <= 6.3:
            raise ValueError("wrap: must be 0 to 6.3 rad")

    def list_friction(self) -> tuple[float, ...]:
        """Return mu at each joint, where tendons of others pass it."""
        return (
            self.friction
            if isinstance(self.friction, tuple)
            else (self.friction,) * len(self.radii)
        )


@dataclass(frozen=True, slots=True)
class BendingSectionConfig:
    """A section of constant curvature, along z where it is straight; its joints are two bends."""

    name: str = "section"  # its bends are NAME.x and NAME.y
    length: float = 0.05  # [m] along its middle line
    bend_max: float = 1.6  # [rad] largest bend towards x and towards y
    bend_speed: float = 6.0  # [rad/s] largest speed of each bend

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        self.to_section()

    def to_section(self) -> CurvedSection:
        """Return the part of an arm."""
        return CurvedSection(self.name, self.length, self.bend_max, bend_speed=self.bend_speed)


@dataclass(frozen=True, slots=True)
class LinkedArmConfig(RoutingConfig):
    """An arm: its tendons and, to be moved in space, its kinematics.

    The first coordinates of the kinematics are the first joints of `radii`; a joint behind them is
    a gripper's. Kinematics are read from a URDF file, or are sections of constant curvature.
    """

    urdf: Path | None = None  # file that describes the links; or
    sections: tuple[BendingSectionConfig, ...] = ()  # of curved ones, from base to tip
    base: str | None = None  # link of the URDF that does not move; null = its root
    tip: str = ""  # link of the URDF that the hand moves
    tool: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m] of the tip point beyond the sections
    # [m/s^2] in the base, for the masses of the URDF; zeros = without weight
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        RoutingConfig.__post_init__(self)
        if self.urdf is not None and self.sections:
            raise ValueError("sections: conflicts with urdf; use one of them")
        if self.urdf is not None and not self.tip:
            raise ValueError("tip: must name the link of the URDF that the hand moves")
        if not all(abs(part) <= 100.0 for part in self.gravity):
            raise ValueError("gravity: must be -100 to 100 m/s^2")
        if any(self.gravity) and self.urdf is None:
            raise ValueError("gravity: needs urdf, with the masses of the links")

    @property
    def has_kinematics(self) -> bool:
        """Whether hands in space can move it."""
        return self.urdf is not None or bool(self.sections)

    @property
    def bend_partners(self) -> list[int]:
        """For each joint the other bend of the same curved section, -1 if there is none."""
        partners = [-1] * len(self.radii)
        for first in range(0, min(2 * len(self.sections), len(partners) - 1), 2):
            partners[first], partners[first + 1] = first + 1, first
        return partners

    def load_kinematics(self) -> Arm:
        """Read the links and joints; `UsageError` if they cannot be read or do not fit."""
        try:
            arm = (
                load_arm(self.urdf, tip=self.tip, base=self.base)
                if self.urdf
                else Arm(tuple(part.to_section() for part in self.sections), Offset(self.tool))
            )
        except ArmError as error:
            raise UsageError(f"arms: sections: {error}") from None
        count, joints = len(arm.coordinates), len(self.radii)
        if joints not in (count, count + 1):
            raise UsageError(
                f"arms: the kinematics have {count} coordinates, but radii have {joints} rows; "
                "give a row for each coordinate, and one more if there is a gripper"
            )
        return arm


@dataclass(frozen=True, slots=True)
class ArmConfig(LinkedArmConfig):
    """An arm as master and slave know it."""

    # relative error of the friction at passed joints, for the interval of the force
    friction_error: float = 0.25
    mass_error: float = 0.1  # relative error of the masses of links, for that interval

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        LinkedArmConfig.__post_init__(self)
        if not 0.0 <= self.friction_error <= 1.0:
            raise ValueError("friction_error: must be 0 to 1")
        if not 0.0 <= self.mass_error <= 1.0:
            raise ValueError("mass_error: must be 0 to 1")


def find_space_joints(arms: Sequence[LinkedArmConfig]) -> tuple[tuple[int, int], ...]:
    """Return first joint and number of joints of arms in space, without grippers.

    `UsageError` if an arm's kinematics cannot be read.
    """
    found, first = [], 0
    for arm in arms:
        if arm.has_kinematics:
            found.append((first, len(arm.load_kinematics().coordinates)))
        first += len(arm.radii)
    return tuple(found)


def assemble_bend_partners(arms: Sequence[LinkedArmConfig], joints: int) -> list[int]:
    """Return for each of a rig's `joints` the other bend of its curved section, or -1."""
    partners: list[int] = []
    for arm in arms:
        first = len(partners)
        partners += [-1 if k < 0 else first + k for k in arm.bend_partners]
    return partners + [-1] * (joints - len(partners))


def assemble_travel_ratios(arms: Sequence[RoutingConfig], joints: int) -> tuple[Array, Array]:
    """Return how the tendons of a rig's joints travel with its joints.

    The arms have the first of the `joints`, one arm after another; the others have tendons of
    their own.

    Returns
    -------
    ratio : array, shape (joints, joints)
        Travel of the tendons of joint k over the travel of joint j, each at its own pulley.
    radius : array, shape (joints,)
        Of the joints' own pulleys [m]; 1 for joints of no arm.

    Raises
    ------
    ValueError
        The arms have more joints than there are.
    """
    count = sum(len(arm.radii) for arm in arms)
    if count > joints:
        raise ValueError(f"{count} rows of radii, but the rig has {joints} joints")
    ratio, radius, first = np.eye(joints), np.ones(joints), 0
    for arm in arms:
        part = slice(first, first + len(arm.radii))
        radius[part] = abs(np.diag(arm.radii))
        ratio[part, part] = np.array(arm.radii) / radius[part]
        first = part.stop
    return ratio, radius
