"""An arm in the scene: its lines, its jaws and the marks of its forces, in scene coordinates."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from teleop.view.space_arm import AXIS_SHARE_MIN, SpaceArm, TipForces, sample_positions

_REACH = 0.8  # of the size of a sheath: how long an arm is drawn
_HAND_TRAVEL = 0.16  # likewise, of a hand that moves by `hand_radius_m`
_AXIS = 0.1  # likewise, of the axes at base and hand
_SPREAD = 0.016  # likewise, from the middle of the arm to its tendons
_JAW = 0.06  # likewise, of the gripper's jaws
_BASE_GAP, _HAND_GAP = 0.12, 0.3  # likewise, from sheaths to base and hand
NUMBER_DISTANCE = 0.12
"""Of the size of a sheath: from a tip or hand to the number beside it."""

_JAW_OPEN, _JAW_MIN, _JAW_MAX = 0.5, 0.04, 1.2  # [rad] of each jaw: at no travel, and its ends


class ArmLines(NamedTuple):
    """Points of an arm in n poses [m]."""

    links: Array  # shape (n, frames, 3)
    joints: Array  # shape (n, joints, 3)
    jaws: Array  # shape (n, jaws, 2, 3); no jaws without a gripper
    tendons: tuple[Array, ...]  # of each tendon, shape (n, points, 3), from the end of its sheath
    tip: Array  # shape (n, 3)


@dataclass(frozen=True, slots=True, eq=False)
class ArmPlacement:
    """Where an arm and its hand are drawn, and how large.

    `ends` [m] are those of the sheath of each tendon, whose joint within the arm is in `tendons`;
    the columns of `rotation` are the axes of the base; `scale` and `hand_scale` are drawn over real
    lengths; `hand` [m] is where the hand is at 0; `size` [m] is that of a sheath.
    """

    arm: SpaceArm
    tendons: Mapping[int, int]
    ends: Mapping[int, Array]
    base: Array
    rotation: Array
    scale: float
    hand: Array
    hand_scale: float
    size: float

    def move(self, offset: Array) -> "ArmPlacement":
        """Return it elsewhere."""
        ends = {tendon: end + offset for tendon, end in self.ends.items()}
        return replace(self, ends=ends, base=self.base + offset, hand=self.hand + offset)

    def to_scene(self, points: Array) -> Array:
        """Return points of the base's frame [m] in the scene, shape (..., 3)."""
        placed: Array = self.base + self.scale * points @ self.rotation.T
        return placed

    def build_lines(self, positions: Array) -> ArmLines:
        """Return what is drawn at travels of the joints [m], shape (n, all joints)."""
        arm = self.arm
        frames = arm.compute_frames(positions)
        links = self.to_scene(frames[..., :3, 3])
        tip, jaws = links[:, -1].copy(), np.empty((len(links), 0, 2, 3))
        if arm.has_gripper:
            jaws = self._build_jaws(frames, tip, arm.get_angles(positions)[:, -1])
            links[:, -1] = jaws[:, 0, 0]
        joints = links[:, arm.find_joint_frames()]
        tendons = tuple(self._build_tendon(frames, tendon) for tendon in self.tendons)
        return ArmLines(links, joints, jaws, tendons, tip)

    def _build_tendon(self, frames: Array, tendon: int) -> Array:
        """Return a tendon from the end of its sheath to its joint, on its side of the arm."""
        places = list(self.tendons)
        angle = 2.0 * np.pi * places.index(tendon) / len(places)
        last = self.arm.find_frames(self.tendons[tendon]) + 1
        axes, across = frames[:, :last, :3, :3], self.arm.across[None, :last, None]
        first, second = (
            np.take_along_axis(axes, across[..., k : k + 1], axis=3)[..., 0] for k in range(2)
        )
        aside = np.cos(angle) * first + np.sin(angle) * second
        points = self.to_scene(frames[:, :last, :3, 3])
        points = points + _SPREAD * self.size * aside @ self.rotation.T
        begin = np.broadcast_to(self.ends[tendon], (len(points), 1, 3))
        return np.concatenate([begin, points], axis=1)

    def _build_jaws(self, frames: Array, tip: Array, angle: Array) -> Array:
        """Return two jaws that meet at the tip when closed; positive travel closes them."""
        axes = frames[:, -1, :3, :3]
        across = self.arm.across[-1]
        (along,) = {0, 1, 2} - set(across.tolist())
        sign = _find_sign(frames, along)
        ahead, aside = (axes[:, :, k] @ self.rotation.T for k in (along, int(across[0])))
        ahead = ahead * sign
        pivot = tip - _JAW * self.size * ahead
        opening = np.clip(_JAW_OPEN - angle / 2.0, _JAW_MIN, _JAW_MAX)[:, None]
        ends = [
            pivot + _JAW * self.size * (np.cos(opening) * ahead + side * np.sin(opening) * aside)
            for side in (1.0, -1.0)
        ]
        return np.stack([np.stack([pivot, end], axis=1) for end in ends], axis=1)

    def build_axes(self, origin: Array, rotation: Array) -> Array:
        """Return three lines from a point along the columns of a rotation, shape (3, 2, 3)."""
        ends = origin + _AXIS * self.size * (self.rotation @ rotation).T
        return np.stack([np.broadcast_to(origin, (3, 3)), ends], axis=1)

    def place_hand(self, positions: Array) -> Array:
        """Return the points of the hand from the device's axes [m], shapes (n, axes), (n, 3)."""
        return self.hand + self.hand_scale * self.turn_hand(positions)

    def turn_hand(self, values: Array) -> Array:
        """Return the device's travels [m] or forces [N] along the scene's axes, shape (n, 3)."""
        hand = self.arm.hand
        if hand is None:
            return np.zeros((len(values), 3))
        turned: Array = hand.select_translation(values) @ self.rotation.T
        return turned

    def build_interval(self, tips: Array, forces: TipForces, limit: float, length: float) -> Array:
        """Return lines through the ends of the arrows, from the low to the high end of each axis.

        An end beyond `limit` [N] is drawn there, an axis that is not told as a point. For a newton
        `length` [m] is drawn. The tips have the shape (n, 3), the lines (n, 3, 2, 3).
        """
        is_identified = forces.axis_shares >= AXIS_SHARE_MIN
        ends = np.repeat(forces.force[:, None, None], 3, axis=1).repeat(2, axis=2)
        for k in range(3):
            for side, end in enumerate((forces.low, forces.high)):
                bounded = np.clip(end[:, k], -limit, limit)
                ends[:, k, side, k] = np.where(is_identified[:, k], bounded, forces.force[:, k])
        lines: Array = tips[:, None, None] + length * ends @ self.rotation.T
        return lines

    def sample_points(self, arrow: float) -> Array:
        """Return points that show the room it needs, with arrows of a length [m] at its tip."""
        lines = self.build_lines(sample_positions(self.arm))
        tips = np.concatenate([lines.tip + arrow * d for d in (*np.eye(3), *-np.eye(3))])
        hand = self.hand + _HAND_TRAVEL * self.size * np.concatenate([np.eye(3), -np.eye(3)])
        shown = [lines.links.reshape(-1, 3), lines.jaws.reshape(-1, 3), tips]
        return np.concatenate([*shown, hand] if self.arm.hand is not None else shown)


def _find_sign(frames: Array, axis: int) -> float:
    """Return 1.0 if the last link runs along an axis of the tip's frame, -1.0 if against it."""
    points = frames[0, :, :3, 3]
    steps = np.linalg.norm(points[-1] - points, axis=1)
    before = np.flatnonzero(steps > 1e-9)
    if len(before) == 0:
        return 1.0
    return 1.0 if (points[-1] - points[before[-1]]) @ frames[0, -1, :3, axis] >= 0.0 else -1.0


def build_arm_placement(
    arm: SpaceArm,
    tendons: Mapping[int, int],
    ends: Mapping[int, tuple[Array, Array, Array]],
    housing: Array,
    size: float,
    hand_radius: float,
) -> ArmPlacement:
    """Return the place of an arm behind its sheaths, its z axis along them.

    `tendons` are its own, each with its joint within the arm; `ends` of each sheath point [m],
    along and aside; `housing` [m] is the middle of their other ends; `size` [m] is that of a
    sheath, `hand_radius` [m] the travel of the hand that is drawn as that of a joint's handle on a
    circle.
    """
    point, along, aside = (np.mean([end[k] for end in ends.values()], axis=0) for k in range(3))
    rotation = np.stack([aside, np.cross(along, aside), along], axis=1)
    return ArmPlacement(
        arm,
        dict(tendons),
        {tendon: end[0] for tendon, end in ends.items()},
        point + _BASE_GAP * size * along,
        rotation,
        _REACH * size / arm.reach,
        housing + np.array([-_HAND_GAP * size, 0.0, 0.0]),
        _HAND_TRAVEL * size / hand_radius,
        size,
    )
