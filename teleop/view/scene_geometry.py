"""Geometry of the scene: the sheaths in space, the joint at their tips, the hand.

Several joints are arranged in rows and columns across the line of sight, so that none hides
another. All in metres along the sheath; tubes, levers and gaps scale with the size of the scene.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from teleop.messages.messages import PROFILE_POINTS
from teleop.view.config import ViewConfig
from teleop.view.scene_arm_geometry import ArmPlacement, build_arm_placement
from teleop.view.space_arm import SpaceArm, find_arm


class CentreLine(NamedTuple):
    """A sheath's centre line and the frame at its end."""

    points: Array  # [m], shape (n, 3)
    along: Array  # unit vector, how the sheath runs at its end
    aside: Array  # unit vector, across it, in the plane of the last bend


def compute_centreline(
    length: Array, radius: Array, s: Array, turn_gap: float = 0.0, planes: Sequence[float] = ()
) -> CentreLine:
    """Return the points of a sheath at the given arc lengths.

    The sheath starts at the origin along +x. Each section is straight or an arc that turns by
    length / radius, to the left for a positive radius, and continues in the direction in which
    the last one ended. All bends lie in the x-y plane unless `planes` turns one out of it. A
    section of more than a full turn would run into itself, so it climbs across its plane by
    `turn_gap` a turn, as a helix of the same length and the same bend angle.

    `length` and `radius` [m], infinite (or 0) for a straight section, have the shape (sections,),
    `s` [m], arc lengths from the housing, (n,); `turn_gap` is in m. `planes` [rad] turn the plane
    of bending about the sheath where each section begins, to the right seen from the housing;
    sections that are not named have 0.
    """
    points = np.zeros((len(s), 3))
    position, begin = np.zeros(3), 0.0
    frame = np.eye(3)  # rows: along the sheath, to the left, up
    for k, (l_k, r_k) in enumerate(zip(length, radius, strict=True)):
        if k < len(planes):
            frame = _build_rotation(planes[k], 0) @ frame
        curvature = 1.0 / r_k if math.isfinite(r_k) and r_k != 0.0 else 0.0
        rise = 0.0
        if abs(l_k * curvature) > 2 * math.pi:
            rise = min(0.5, turn_gap * abs(curvature) / (2 * math.pi))
        inside = s >= begin
        if k < len(length) - 1:
            inside &= s < begin + l_k
        points[inside] = (
            position + _compute_section_path(s[inside] - begin, curvature, rise) @ frame
        )
        position = position + _compute_section_path(np.array([l_k]), curvature, rise)[0] @ frame
        frame = _build_rotation(l_k * curvature, 2) @ frame
        begin += l_k
    return CentreLine(points, frame[0], frame[1])


def _compute_section_path(d: Array, curvature: float, rise: float) -> Array:
    """Return the way travelled [m] after arc length `d` of one section, in the frame it began with.

    `rise` is the climb across the plane for a way of 1.
    """
    flat = math.sqrt(1.0 - rise * rise)
    angle = d * curvature
    x = d if curvature == 0.0 else np.sin(angle) / curvature
    y = np.zeros_like(d) if curvature == 0.0 else (1.0 - np.cos(angle)) / curvature
    return np.stack([flat * x, flat * y, rise * d], axis=1)


def _build_rotation(angle: float, axis: int) -> Array:
    """Return the rows of a frame turned about its own row `axis`."""
    turned = np.eye(3)
    i, k = (axis + 1) % 3, (axis + 2) % 3
    turned[i, i] = turned[k, k] = math.cos(angle)
    turned[i, k], turned[k, i] = math.sin(angle), -math.sin(angle)
    return turned


# --- the arrangement in the scene


SEGMENTS = PROFILE_POINTS - 1
PIECES = 4  # straight pieces drawn for each segment of one colour
_CELL_GAP = 0.08  # between two joints
_TIP_GAP = 0.05  # from sheath to joint
EYE = (0.0, -0.8, 0.78)  # where the scene is seen from, in spans from its centre
RIGHT, UP = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.78, 0.8]) / math.hypot(0.78, 0.8)
_VIEW_ASPECT = 1.5  # the view's width over its height, a margin taken off
_FIT_ITERATIONS = 12  # of fitting the scene into the view
_SCALE_HEIGHT, _SCALE_OFFSET = 0.5, 0.16  # the colour scale's height, and its place from the rest
_ARM_ARROW = 0.5  # of the scale of forces, for which there is room at an arm in any pose
_ARM_SPACING = 0.6  # of the spacing of tendons, as an arm has many
_WEDGE, _WEDGE_STEPS = 0.5, 12  # [rad] of the environment, as drawn, and its corners
_LEVER_ANGLES = np.linspace(-1.0, 1.3, 4)  # [rad] within which a lever must be seen
_LEVER_LENGTH = 0.16  # a joint's link and the hand's handle
ARROW = 0.25  # of the force at the end of its scale
_LABEL_DISTANCE, _LABEL_PLACES = 0.14, 24  # of the number beside it: distance, and places tried


@dataclass(frozen=True, slots=True)
class Shape:
    """Geometry of one sheath."""

    joint: int  # the one it moves
    length: tuple[float, ...]  # [m] of each section
    radius: tuple[float, ...]  # [m] inf = straight


@dataclass(frozen=True, slots=True)
class Lever:
    """A link that turns about a pivot, in the plane of `along` and `aside`."""

    pivot: Array  # [m]
    along: Array  # unit vector, where it points at travel 0
    aside: Array  # unit vector, where it turns to
    length: float  # [m] as drawn
    radius: float  # [m] of the pulley it is drawn on: angle = travel / radius
    label: Array = field(default_factory=lambda: np.zeros(3))  # [m] from its far end to its number

    def compute_tip(self, travel: Array) -> Array:
        """Return the link's far end, shape (n, 3), at each travel [m]."""
        angle = np.asarray(travel)[..., None] / self.radius
        turned: Array = np.cos(angle) * self.along + np.sin(angle) * self.aside
        return self.pivot + self.length * turned

    def compute_direction(self, travel: Array) -> Array:
        """Return unit vectors along which the far end moves as the travel grows, shape (n, 3)."""
        angle = np.asarray(travel)[..., None] / self.radius
        turned: Array = -np.sin(angle) * self.along + np.cos(angle) * self.aside
        return turned

    def sweep(self, begin: float) -> Array:
        """Return where the far end goes from a travel [m] by `_WEDGE` on, shape (n, 3)."""
        beyond = math.copysign(_WEDGE * self.radius, begin)
        return self.compute_tip(np.linspace(begin, begin + beyond, _WEDGE_STEPS + 1))

    @property
    def aslant(self) -> Array:
        """From the far end to what stands beside it, across the plane [m]."""
        offset: Array = 0.12 * self.length * np.cross(self.along, self.aside)
        return offset


@dataclass(frozen=True, slots=True)
class Stage:
    """Positions of everything drawn [m]."""

    size: float  # of a sheath
    span: float  # of everything drawn, as seen from the eye: 1 fills the view
    centre: Array
    lines: Mapping[int, Array]  # tendon -> points at evenly spread arc lengths
    joints: Mapping[int, Lever]
    hands: Mapping[int, Lever]
    arms: tuple[ArmPlacement, ...]  # in space; their joints have no levers
    legend: Array  # the foot of the colour scale
    legend_up: Array  # from its foot to its top


def build_stage(
    shapes: Mapping[int, Shape], config: ViewConfig, arms: Sequence[SpaceArm] = ()
) -> Stage:
    """Return the positions of sheaths, joints, arms in space and hands."""
    straight = _build_centrelines(shapes, config)
    cloud = np.concatenate([line.points for line in straight.values()])
    size = float(np.ptp(cloud, axis=0).max())
    across = _find_least_extent_axis(cloud)
    lines: dict[int, Array] = {}
    levers: dict[int, Lever] = {}
    hands: dict[int, Lever] = {}
    places: dict[int, ArmPlacement] = {}  # by the first joint
    drawn: dict[int, Array] = {}  # of each cell, by its first joint
    cells: dict[int, list[int]] = {}  # first joint -> tendons
    for joint in sorted({shape.joint for shape in shapes.values()}):
        arm = find_arm(arms, joint)
        first = joint if arm is None else arm.first
        own = sorted(tendon for tendon, shape in shapes.items() if shape.joint == joint)
        spacing = config.tendon_spacing * (1.0 if arm is None else _ARM_SPACING)
        cell = cells.setdefault(first, [])
        for tendon in own:
            lines[tendon] = straight[tendon].points + len(cell) * spacing * size * across
            cell.append(tendon)
        if arm is None:
            ends = [(lines[t][-1], straight[t].along, straight[t].aside) for t in own]
            levers[joint] = _build_joint_lever(ends, size, config)
        if arm is None or arm.hand is None:
            hands[joint] = _build_hand_lever([lines[tendon][0] for tendon in own], size, config)
    for first, cell in cells.items():
        arm = find_arm(arms, first)
        parts = [lines[tendon] for tendon in cell]
        if arm is not None:
            places[first] = build_arm_placement(
                arm,
                {tendon: shapes[tendon].joint - first for tendon in cell},
                {t: (lines[t][-1], straight[t].along, straight[t].aside) for t in cell},
                np.mean([lines[tendon][0] for tendon in cell], axis=0),
                size,
                config.hand_radius_m,
            )
            parts.append(places[first].sample_points(_ARM_ARROW * ARROW * size))
        joints = [first] if arm is None else list(arm.joints)
        parts += [_compute_reach(levers[joint], -1) for joint in joints if joint in levers]
        parts += [_compute_reach(hands[joint], 1) for joint in joints if joint in hands]
        drawn[first] = np.concatenate(parts)
    for first, offset in _compute_cell_offsets(drawn, size).items():
        drawn[first] = drawn[first] + offset
        if first in places:
            places[first] = places[first].move(offset)
        for each in (levers, hands):
            for joint in {shapes[tendon].joint for tendon in cells[first]} & set(each):
                each[joint] = replace(each[joint], pivot=each[joint].pivot + offset)
        for tendon in cells[first]:
            lines[tendon] = lines[tendon] + offset
    still = np.concatenate([*lines.values(), *(h.pivot[None] for h in hands.values())])
    for each, sign in ((levers, -1.0), (hands, 1.0)):
        for joint, lever in each.items():
            each[joint] = replace(lever, label=_find_clear_offset(lever, sign, still, size))
    centre, span, right, tall = _fit_frame(np.concatenate(list(drawn.values())))
    return Stage(
        size,
        span,
        centre,
        lines,
        levers,
        hands,
        tuple(places.values()),
        legend=centre + span * (right * RIGHT - _SCALE_HEIGHT * tall / 2 * UP),
        legend_up=span * _SCALE_HEIGHT * tall * UP,
    )


def _build_centrelines(shapes: Mapping[int, Shape], config: ViewConfig) -> dict[int, CentreLine]:
    """Return the sheaths, all from the origin."""
    total = {t: float(sum(shape.length)) for t, shape in shapes.items()}
    gap = 0.05 * max(total.values())
    return {
        tendon: compute_centreline(
            np.array(shape.length),
            np.array(shape.radius),
            np.linspace(0.0, total[tendon], SEGMENTS * PIECES + 1),
            gap,
            config.bend_planes,
        )
        for tendon, shape in shapes.items()
    }


def _compute_cell_offsets(drawn: Mapping[int, Array], size: float) -> dict[int, Array]:
    """Return the offsets of the joints in rows and columns, the first on top.

    All cells are as large as the largest; there are as many columns as let them be drawn largest.
    """
    low = {j: np.array([(p @ RIGHT).min(), (p @ UP).min()]) for j, p in drawn.items()}
    high = {j: np.array([(p @ RIGHT).max(), (p @ UP).max()]) for j, p in drawn.items()}
    wide, tall = np.max([high[j] - low[j] for j in drawn], axis=0) + _CELL_GAP * size
    count = len(drawn)
    columns = min(
        range(1, count + 1), key=lambda n: max(n * wide, math.ceil(count / n) * tall * _VIEW_ASPECT)
    )
    offsets = {}
    for place, joint in enumerate(drawn):
        row, column = divmod(place, columns)
        right, up = np.array([column * wide, -row * tall]) - (low[joint] + high[joint]) / 2
        offsets[joint] = right * RIGHT + up * UP
    return offsets


def _compute_reach(lever: Lever, sign: float) -> Array:
    """Return points that a lever and the arrow at its end reach."""
    travel = lever.radius * _LEVER_ANGLES
    arrows = sign * ARROW / _LEVER_LENGTH * lever.length * lever.compute_direction(travel)
    return np.concatenate(
        [lever.pivot[None], lever.compute_tip(travel), lever.compute_tip(travel) + arrows]
    )


def _find_clear_offset(lever: Lever, sign: float, still: Array, size: float) -> Array:
    """Return where a number beside a lever's far end is clearest of what is drawn.

    Of places around the end, the one whose nearest drawn point, as seen from the eye and at any
    travel, is farthest. A number is wider than it is tall, so distances across count half.

    `sign` is that of the arrow at its end, along its motion; `still` [m], shape (n, 3), are points
    of what does not move: the link and its arrow move with the number; `size` [m] is that of a
    sheath.
    """
    flat = np.array([0.5 * RIGHT, UP])
    angles = np.linspace(0.0, 2 * np.pi, _LABEL_PLACES, endpoint=False)
    offsets = (
        _LABEL_DISTANCE * size * (np.outer(np.cos(angles), RIGHT) + np.outer(np.sin(angles), UP))
    )
    clear = np.full(len(offsets), np.inf)
    along = np.linspace(0.0, 1.0, 9)[:, None]
    for travel in lever.radius * _LEVER_ANGLES:
        at = np.array([travel])
        end, onward = lever.compute_tip(at)[0], sign * lever.compute_direction(at)[0]
        link = lever.pivot + along * (end - lever.pivot)
        arrow = end + along * ARROW * size * onward
        obstacles = np.concatenate([still, link, arrow]) @ flat.T
        gaps = (end + offsets) @ flat.T
        distance = np.linalg.norm(gaps[:, None] - obstacles[None], axis=-1).min(axis=1)
        clear = np.minimum(clear, distance)
    chosen: Array = offsets[clear.argmax()]
    return chosen


def _fit_frame(drawn: Array) -> tuple[Array, float, float, float]:
    """Return centre and span [m] with which all points fit into the view, as seen from the eye.

    Also the right edge and the height of what is drawn, in spans. What is nearer looks larger, so
    each round starts from where the last one left the points.
    """
    far = float(np.linalg.norm(EYE))
    forward = -np.array(EYE) / far
    centre, span, right, tall = drawn.mean(axis=0), float(np.ptp(drawn)), 0.0, 1.0
    for _ in range(_FIT_ITERATIONS):
        place = (drawn - centre) / span
        place *= far / np.maximum(far + place @ forward, 0.2 * far)[:, None]
        x, y = place @ RIGHT, place @ UP
        left, right, tall = float(x.min()), float(x.max()) + _SCALE_OFFSET, float(np.ptp(y))
        centre = centre + span * ((left + right) / 2 * RIGHT + (y.min() + y.max()) / 2 * UP)
        right -= (left + right) / 2
        span *= max((right * 2) / _VIEW_ASPECT, tall)
    return centre, span, right, tall


def _build_joint_lever(
    ends: list[tuple[Array, Array, Array]], size: float, config: ViewConfig
) -> Lever:
    points, along, aside = (np.mean([end[k] for end in ends], axis=0) for k in range(3))
    pivot = points + _TIP_GAP * size * along
    return Lever(pivot, along, aside, _LEVER_LENGTH * size, config.joint_radius_m)


def _build_hand_lever(points: list[Array], size: float, config: ViewConfig) -> Lever:
    back, left = np.array([-1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    pivot = np.mean(points, axis=0) + _TIP_GAP * size * back
    return Lever(pivot, left, -back, _LEVER_LENGTH * size, config.hand_radius_m)


def _find_least_extent_axis(cloud: Array) -> Array:
    """Return the unit vector along which the sheaths extend least; up if they lie flat."""
    spread = np.cov(cloud.T) + np.diag([0.0, 1e-6, 0.0]) * np.var(cloud)
    axis: Array = np.linalg.eigh(spread)[1][:, 0]
    return -axis if axis[np.abs(axis).argmax()] < 0 else axis


def compute_rotations_from_z(directions: Array) -> Array:
    """Return quaternions (x, y, z, w) that turn the z axis into each direction, shape (n, 4)."""
    x, y, z = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).T
    turned = np.stack([-y, x, np.zeros_like(x), 1.0 + z], axis=1)
    turned[z < -1 + 1e-9] = (1.0, 0.0, 0.0, 0.0)
    unit: Array = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    return unit
