"""The joints of an arm and the tendons that they share, as every process knows them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.kinematics.arm import Arm, ArmError, CurvedSection, Offset
from estimator.kinematics.urdf import URDF_BYTES_MAX, read_arm
from teleop.config.ranges import build_ranged_field, check_ranges
from teleop.errors import UsageError
from teleop.runtime.files import read_small_file

RADIUS_MIN, RADIUS_MAX = 1e-4, 1.0  # [m]
CONDITION_MAX = 1e4  # of the matrix of travels: beyond it joints cannot be told apart
BALANCE_ERROR = 1e-3  # of tensions that balance, as radii are rounded
PATTERN_MIN = 0.05  # of the tensions in balance, over the largest: beyond it one is all the others


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

    Column j of `radii` belongs to joint j. With as many rows, row k belongs to the tendons of joint
    k, of one or of a pair, which travel by the sum of radii[k][j] times the angle of joint j. With
    more rows, each belongs to one tendon, in the order of the rig's: n + 1 tendons for n joints, or
    three for the two bends of a section; positive tensions must balance them.
    """

    # [m] signed pulley radii; of a square table the diagonal is a joint's own pulley
    radii: tuple[tuple[float, ...], ...] = ((0.005,),)
    # mu of tendons at the joints that they pass: one, or one a joint
    friction: float | tuple[float, ...] = 0.1
    # of a tendon at each of them while the joint is straight
    wrap: float = build_ranged_field(0.0, 0.0, 6.3, "rad")
    # of tendon from the guide at each joint to the next, or to its anchor; not in curved sections
    span: float = build_ranged_field(0.03, 1e-3, 1.0, "m")

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.radii or any(len(row) != len(self.radii[0]) for row in self.radii):
            raise ValueError("radii: must be a table, a column for each joint")
        if not 0 < self.joints <= len(self.radii):
            raise ValueError("radii: must have a row for each joint, or one for each tendon")
        radii = np.array(self.radii)
        if not (abs(radii) <= RADIUS_MAX).all():
            raise ValueError(f"radii: must be -{RADIUS_MAX:g} to {RADIUS_MAX:g} m")
        own = self.pulleys
        if not (own >= RADIUS_MIN).all():
            raise ValueError(
                f"radii: joint {own.argmin() + 1}: its own tendons must turn it, by a radius of at "
                f"least {RADIUS_MIN:g} m{'' if self.has_tendon_rows else ' (the diagonal)'}"
            )
        if not np.linalg.cond(radii / own) <= CONDITION_MAX:
            raise ValueError("radii: these tendons do not determine all joints (singular matrix)")
        if self.has_tendon_rows:
            find_tendon_groups(radii)
        if not all(0.0 <= mu <= 1.0 for mu in self.list_friction()):
            raise ValueError("friction: must be 0 to 1")
        if len(self.list_friction()) != self.joints:
            raise ValueError(f"friction: must be one number, or {self.joints}: one a joint")

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.radii[0])

    @property
    def has_tendon_rows(self) -> bool:
        """Whether each row of `radii` belongs to one tendon."""
        return len(self.radii) > self.joints

    @property
    def pulleys(self) -> Array:
        """Radius [m] by which travels of each joint count, shape (joints,)."""
        size = abs(np.array(self.radii))
        return size.max(axis=0) if self.has_tendon_rows else np.diag(size)

    def list_friction(self) -> tuple[float, ...]:
        """Return mu at each joint, where tendons of others pass it."""
        return self.friction if isinstance(self.friction, tuple) else (self.friction,) * self.joints


@dataclass(frozen=True, slots=True)
class BendingSectionConfig:
    """A section of constant curvature, along z where it is straight; its joints are two bends."""

    name: str = "section"  # its bends are NAME.x and NAME.y
    length: float = 0.05  # [m] along its middle line
    bend_max: float = 1.6  # [rad] largest bend towards x and towards y
    bend_speed: float = 6.0  # [rad/s] largest speed of each bend
    # spread evenly along its middle line; of simulated arms
    mass: float = build_ranged_field(0.0, 0.0, 10.0, "kg")

    def __post_init__(self) -> None:
        check_ranges(self)
        self.to_section()

    def to_section(self) -> CurvedSection:
        """Return the part of an arm."""
        return CurvedSection(
            self.name, self.length, self.bend_max, bend_speed=self.bend_speed, mass=self.mass
        )


@dataclass(frozen=True, slots=True)
class LinkedArmConfig(RoutingConfig):
    """An arm: its tendons and, to be moved in space, its kinematics.

    The coordinates of the kinematics are the first columns of `radii`; a joint behind them is
    a gripper's. Kinematics are read from a URDF file, or are sections of constant curvature.
    """

    urdf: Path | None = None  # file that describes the links; or
    sections: tuple[BendingSectionConfig, ...] = ()  # of curved ones, from base to tip
    base: str | None = None  # link of the URDF that does not move; null = its root
    tip: str = ""  # link of the URDF that the hand moves
    tool: tuple[float, float, float] = (0.0, 0.0, 0.0)  # [m] of the tip point beyond the sections
    # [m/s^2] in the base, for the masses of the URDF; zeros = without weight
    gravity: tuple[float, float, float] = build_ranged_field((0.0,) * 3, -100.0, 100.0, "m/s^2")

    def __post_init__(self) -> None:
        RoutingConfig.__post_init__(self)
        if self.urdf is not None and self.sections:
            raise ValueError("sections: conflicts with urdf; use one of them")
        if self.urdf is not None and not self.tip:
            raise ValueError("tip: must name the link of the URDF that the hand moves")
        if any(self.gravity) and self.urdf is None:
            raise ValueError("gravity: needs urdf, with the masses of the links")

    @property
    def has_kinematics(self) -> bool:
        """Whether hands in space can move it."""
        return self.urdf is not None or bool(self.sections)

    @property
    def bend_partners(self) -> list[int]:
        """For each joint the other bend of the same curved section, -1 if there is none."""
        partners = [-1] * self.joints
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
        count, joints = len(arm.coordinates), self.joints
        if joints not in (count, count + 1):
            raise UsageError(
                f"arms: the kinematics have {count} coordinates, but radii have {joints} columns; "
                "give one for each coordinate, and one more if there is a gripper"
            )
        return arm


@dataclass(frozen=True, slots=True)
class ArmConfig(LinkedArmConfig):
    """An arm as master and slave know it."""

    # relative error of the friction at passed joints, for the interval of the force
    friction_error: float = build_ranged_field(0.25, 0.0, 1.0)
    # relative error of the masses of links, for that interval
    mass_error: float = build_ranged_field(0.1, 0.0, 1.0)


def find_space_joints(arms: Sequence[LinkedArmConfig]) -> tuple[tuple[int, int], ...]:
    """Return first joint and number of joints of arms in space, without grippers.

    `UsageError` if an arm's kinematics cannot be read.
    """
    found, first = [], 0
    for arm in arms:
        if arm.has_kinematics:
            found.append((first, len(arm.load_kinematics().coordinates)))
        first += arm.joints
    return tuple(found)


def assemble_lengths(arms: Sequence[LinkedArmConfig], travel: Array) -> Array:
    """Return the length of each tendon at each joint of arms [m], as `travel` of `TendonRows`.

    That in a curved section is shared by the bends that move the tendon.
    """
    lengths: list[float] = []
    for arm in arms:
        bends = [section.length for section in arm.sections for _ in range(2)]
        lengths += (bends + [arm.span] * arm.joints)[: arm.joints]
    joints = travel.shape[1]
    partner, moves = np.array(assemble_bend_partners(arms, joints)), travel != 0.0
    shared = moves & (partner >= 0) & moves[:, partner]
    there = np.array(lengths + [0.0] * (joints - len(lengths)))
    return np.asarray(np.where(moves, there, 0.0) / (1.0 + shared))


def assemble_bend_partners(arms: Sequence[LinkedArmConfig], joints: int) -> list[int]:
    """Return for each of a rig's `joints` the other bend of its curved section, or -1."""
    partners: list[int] = []
    for arm in arms:
        first = len(partners)
        partners += [-1 if k < 0 else first + k for k in arm.bend_partners]
    return partners + [-1] * (joints - len(partners))


class TendonRows(NamedTuple):
    """How the tendons of a rig travel with its joints, each joint at its own pulley."""

    travel: Array  # of a tendon over that of a joint, shape (tendons, joints)
    inverse: Array  # of it, shape (joints, tendons)
    radius: Array  # [m] of the joints' own pulleys, shape (joints,); 1 for joints of no arm
    groups: list[tuple[list[int], Array]]  # see `find_tendon_groups`; a single tendon is one, too


def assemble_tendon_rows(
    arms: Sequence[RoutingConfig], joints: Sequence[Sequence[int]]
) -> TendonRows:
    """Return how the tendons of a rig travel.

    The arms have the first of the `joints`, one arm after another; the others have tendons of
    their own.

    Raises `ValueError` if the arms have more joints than there are, or more tendons than these.
    """
    n, count = len(joints), sum(arm.joints for arm in arms)
    if count > n:
        raise ValueError(f"radii for {count} joints, but the rig has {n}")
    tendons = sum(map(len, joints))
    travel, inverse, radius = np.zeros((tendons, n)), np.zeros((n, tendons)), np.ones(n)
    groups: list[tuple[list[int], Array]] = []
    single = RoutingConfig(((1.0,),))
    first = 0
    for arm in [*arms, *[single] * (n - count)]:
        part = slice(first, first + arm.joints)
        first, radius[part] = part.stop, arm.pulleys
        table, own = np.array(arm.radii) / radius[part], [list(row) for row in joints[part]]
        if arm.has_tendon_rows:
            moved = [tendon for row in own for tendon in row]
            if len(moved) != len(table):
                raise ValueError(
                    f"{len(table)} rows of radii, but its joints have {len(moved)} tendons"
                )
            travel[moved, part], inverse[part, moved] = table, np.linalg.pinv(table).round(12)
            groups += [([moved[i] for i in row], t) for row, t in find_tendon_groups(table)]
            continue
        for row, column, row_tendons in zip(table, np.linalg.inv(table).T, own, strict=True):
            for sign, tendon in zip((1.0, -1.0), row_tendons, strict=False):
                travel[tendon, part] = sign * row
                inverse[part, tendon] = sign * column / len(row_tendons)
            groups.append((row_tendons, np.ones(len(row_tendons))))
    return TendonRows(travel, inverse, radius, groups)


def find_tendon_groups(travel: Array) -> list[tuple[list[int], Array]]:
    """Return the groups of tendons that balance, and the tensions in balance over their least.

    A group is n + 1 tendons of n joints, or three of a curved section. Their tips travel by
    sum t_i x_i = const. `travel` has the shape (tendons, joints).

    Raises `ValueError` if tendons do not fall into such groups; the message names one.
    """
    balanced = np.eye(len(travel)) - travel @ np.linalg.pinv(travel)
    groups: list[tuple[list[int], Array]] = []
    for i, row in enumerate(balanced):
        members = np.flatnonzero(abs(row) > BALANCE_ERROR)
        if any(i in group for group, _ in groups):
            continue
        misfit = abs(balanced[members] * row[i] - np.outer(row[members], row)).max(initial=0.0)
        if not (
            misfit < BALANCE_ERROR
            and len(members) > 1
            and row[members].min() > PATTERN_MIN * row.max()
        ):
            rows = [k + 1 for k in members] if len(members) > 1 else [i + 1]
            raise ValueError(
                f"radii: row{'s' * (len(rows) > 1)} {', '.join(map(str, rows))}: there must be one "
                "ratio of positive tensions in which these tendons balance; give n + 1 tendons for "
                "n joints, three a section"
            )
        groups.append((members.tolist(), row[members] / row[members].min()))
    return groups


def find_guides(travel: Array, partners: Sequence[int]) -> NDArray[np.bool_]:
    """Return which tendons rub at which joints: those that they pass, shape (tendons, joints).

    A tendon ends at the last joint that it moves. A curved section, whose other bend is in
    `partners`, counts once.
    """
    moves, partner = travel != 0.0, np.array(partners)
    last = [int(np.flatnonzero(row)[-1]) for row in moves]
    guides: NDArray[np.bool_] = moves.copy()
    for tendon, end in enumerate(last):
        for j in np.flatnonzero(moves[tendon]):
            counted = 0 <= partner[j] < j and moves[tendon, partner[j]]
            guides[tendon, j] = end not in (j, partner[j]) and not counted
    return guides
