"""Arms in space: where their parts are, and the force at their tips from those on their joints.

SlaveState gives the travel of joint k at its own pulley and the force there, positive against
positive travel: its coordinate is travel / radius, the torque of the environment on it is
-radius * force.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.kinematics.arm import Arm, CurvedSection, Offset, PreparedArm, prepare_arm
from estimator.kinematics.tip_wrench import bound_product, compute_tip_wrench
from estimator.structs import StructArray, view_struct
from teleop.config.arm import ArmConfig
from teleop.config.loading import ConfigDocument
from teleop.errors import UsageError
from teleop.runtime.process import print_warning

AXIS_SHARE_MIN = 0.9
"""Share of a base axis, squared cosine, that must lie in the directions that can be told."""

_POINTS = 8  # along a curved section
_TOLD_SHARE_MIN = 1.0 - 1e-6  # of a direction, squared cosine
_SAMPLE_RAD = 0.8  # of each joint, for the room that an arm needs
_TRANSLATIONS = ("x", "y", "z")
_DEFAULT_HAND: dict[str, Any] = {"axes": _TRANSLATIONS}


class HandAxes(NamedTuple):
    """Which axes of the device move an arm in space."""

    first: int  # of the device's axes
    names: tuple[str, ...]  # x, y, z, roll, pitch, yaw, grip
    rotation: Array  # shape (3, 3), of the device in the arm's base

    def select_translation(self, values: Array) -> Array:
        """Return x, y and z of the device's axes in the arm's base, shapes (n, axes), (n, 3)."""
        vectors = np.zeros((len(values), 3))
        for k, name in enumerate(self.names):
            if name in _TRANSLATIONS and self.first + k < values.shape[1]:
                vectors[:, _TRANSLATIONS.index(name)] = values[:, self.first + k]
        rotated: Array = vectors @ self.rotation.T
        return rotated


class TipForces(NamedTuple):
    """Forces of the environment on a tip [N], in the base; directions not told are left out."""

    force: Array  # shape (n, 3)
    low: Array  # ends of each component, shape (n, 3)
    high: Array
    along_low: Array  # ends of the component along the force itself, shape (n,)
    along_high: Array
    axis_shares: Array  # of each base axis in the directions that are told, shape (n, 3)

    def list_components(self) -> list[tuple[Array, Array, Array]]:
        """Return force, low and high end of x, y and z, each shape (n,); NaN where not told."""
        is_identified = self.axis_shares >= AXIS_SHARE_MIN
        force, low, high = (
            np.where(is_identified, part, np.nan) for part in (self.force, self.low, self.high)
        )
        return [(force[:, k], low[:, k], high[:, k]) for k in range(3)]


@dataclass(frozen=True, slots=True, eq=False)
class SpaceArm:
    """An arm whose kinematics are known.

    `first` is the first of its joints, `radius` [m] that of their own pulleys, the gripper's last
    if there is one; `parts` are those of each frame, as of `compute_part_frames`, `across` the two
    axes of each frame across the arm, of its three; `reach` [m] is from the base to the tip,
    stretched out.
    """

    first: int
    radius: Array
    prepared: PreparedArm
    coordinates: int
    parts: NDArray[np.int64]
    across: NDArray[np.int64]
    reach: float
    hand: HandAxes | None

    @property
    def joints(self) -> range:
        """The numbers of its joints."""
        return range(self.first, self.first + len(self.radius))

    @property
    def has_gripper(self) -> bool:
        """Whether a joint behind the kinematics moves jaws."""
        return len(self.radius) > self.coordinates

    def get_angles(self, positions: Array) -> Array:
        """Return the angles of its joints from travels [m], shapes (n, all), (n, joints)."""
        own = positions[:, self.joints.start : self.joints.stop]
        return np.ascontiguousarray(own / self.radius)  # compiled functions take such rows

    def compute_frames(self, positions: Array) -> Array:
        """Return the frames along the arm in its base, shape (n, frames, 4, 4)."""
        from estimator.kinematics.forward import compute_part_frames

        frames = np.empty((len(positions), len(self.parts), 4, 4))
        for row, angles in zip(frames, self.get_angles(positions), strict=True):
            row[:] = compute_part_frames(self.prepared, angles, _POINTS)[0]
        return frames

    def compute_tips(self, positions: Array) -> Array:
        """Return the points of the tip in the base [m], shape (n, 3)."""
        from estimator.kinematics.forward import compute_tip_pose

        tips = np.empty((len(positions), 3))
        for row, angles in zip(tips, self.get_angles(positions), strict=True):
            row[:] = compute_tip_pose(self.prepared, angles)[:3, 3]
        return tips

    def find_known(self, rows: NDArray[np.void]) -> NDArray[np.bool_]:
        """Return which rows with positions of the joints have those of all of this arm's."""
        finite = np.isfinite(rows["position"][:, self.joints]).all(axis=1)
        known: NDArray[np.bool_] = finite
        if "joints" in (rows.dtype.names or ()):
            known = finite & (rows["joints"] >= self.joints.stop)
        return known

    def estimate_tip_forces(self, rows: NDArray[np.void]) -> TipForces:
        """Return the forces at the tip in rows of SlaveState; not finite where they are unknown."""
        from estimator.kinematics.forward import compute_jacobian

        angles, known = self.get_angles(rows["position"]), self.find_known(rows)
        jacobians = np.zeros((len(angles), 6, self.coordinates))
        for row in np.flatnonzero(known):
            jacobians[row] = compute_jacobian(self.prepared, angles[row])
        own = self.joints[: self.coordinates]
        torque, torque_high, torque_low = (
            np.where(known[:, None], -self.radius[: self.coordinates] * rows[name][:, own], np.nan)
            for name in ("force", "force_low", "force_high")
        )
        return solve_tip_forces(jacobians, torque, torque_low, torque_high)

    def find_frames(self, joint: int) -> int:
        """Return the frame at which the tendons of a joint of this arm end."""
        if joint >= self.coordinates:
            return len(self.parts) - 1
        part = int(np.searchsorted(self._find_last_coordinates(), joint))
        return int(np.flatnonzero(self.parts == part)[-1])

    def find_joint_frames(self) -> list[int]:
        """Return the frames at which it has joints; a curved section has none."""
        moved = np.diff(self._find_last_coordinates(), prepend=-1) > 0
        return [
            frame
            for frame, part in enumerate(self.parts)
            if 0 <= part < len(moved) and moved[part] and (self.parts == part).sum() == 1
        ]

    def _find_last_coordinates(self) -> Array:
        """Return the last coordinate of each part or of those before it, shape (parts,)."""
        count = self.prepared.parts
        firsts = [*self.prepared.first[1:count].tolist(), self.coordinates]
        return np.array(firsts) - 1


def find_arm(arms: Sequence[SpaceArm], joint: int) -> SpaceArm | None:
    """Return the arm that has a joint."""
    return next((arm for arm in arms if joint in arm.joints), None)


def solve_tip_forces(
    jacobians: Array, torque: Array, torque_low: Array, torque_high: Array
) -> TipForces:
    """Return forces at a tip that explain the torques on the joints, of `compute_tip_wrench`.

    Of the force only directions are kept that the torques determine, whatever the moment.

    `jacobians`, shape (n, 6, coordinates), are geometric ones of the tip; `torque` with its ends [N
    m] or [N], shape (n, coordinates), is that of the environment on the joints.
    """
    found = compute_tip_wrench(jacobians, torque, torque_low, torque_high)
    identified = found.directions[:, :, :3] * found.is_identified[:, :, None]
    shares, directions = np.linalg.eigh(np.swapaxes(identified, 1, 2) @ identified)
    kept = directions * (shares >= _TOLD_SHARE_MIN)[:, None]
    projector = kept @ np.swapaxes(kept, 1, 2)
    inverse = projector @ found.inverse[:, :3]
    force = np.einsum("nij,nj->ni", inverse, torque)
    low, high = bound_product(inverse, torque_low, torque_high)
    size = np.linalg.norm(force, axis=1, keepdims=True)
    along = np.einsum("ni,nij->nj", force / np.where(size > 0.0, size, 1.0), inverse)
    (along_low,), (along_high,) = (
        end.T for end in bound_product(along[:, None], torque_low, torque_high)
    )
    axis_shares = np.diagonal(projector, axis1=1, axis2=2)
    return TipForces(force, low, high, along_low, along_high, axis_shares)


# --- from the config of a session


def load_arms(document: ConfigDocument, configs: Sequence[ArmConfig]) -> tuple[SpaceArm, ...]:
    """Return the arms of a session that have kinematics.

    One that cannot be read is left out with a warning, as its joints can be shown without it.
    """
    arms: list[SpaceArm] = []
    hands, first = _read_hands(document), 0
    for number, config in enumerate(configs):
        if config.has_kinematics:
            try:
                arm = config.load_kinematics()
            except UsageError as error:
                print_warning(
                    f"{error}; arm {number + 1} is drawn as single joints: name the config of the "
                    "session by --config, beside the files that it names"
                )
            else:
                hand = hands[number] if number < len(hands) else None
                arms.append(build_space_arm(arm, first, config.pulleys, hand))
        first += config.joints
    return tuple(arms)


def build_space_arm(arm: Arm, first: int, radius: Array, hand: HandAxes | None = None) -> SpaceArm:
    """Return what draws an arm whose joints begin with `first`; compiles what it needs."""
    from estimator.kinematics.forward import compute_jacobian, compute_part_frames, compute_tip_pose

    records: StructArray = prepare_arm(arm)
    prepared: PreparedArm = view_struct(records)
    straight = np.zeros(len(radius))
    compute_jacobian(prepared, straight)
    compute_tip_pose(prepared, straight)
    frames, parts = compute_part_frames(prepared, straight, _POINTS)
    reach = float(np.linalg.norm(arm.tip.position))
    for part in arm.parts:
        reach += float(np.linalg.norm(part.offset.position))
        reach += part.length if isinstance(part, CurvedSection) else 0.0
    across = _find_axes_across(frames)
    return SpaceArm(
        first, np.array(radius), prepared, len(arm.coordinates), parts, across, reach, hand
    )


def sample_positions(arm: SpaceArm) -> Array:
    """Return travels [m] of poses that show the room that an arm needs, shape (n, all joints)."""
    count = arm.coordinates
    lower, upper = arm.prepared.lower[:count], arm.prepared.upper[:count]
    angles = np.zeros((2 * count + 1, count))
    for k in range(count):
        angles[2 * k, k] = max(lower[k], -_SAMPLE_RAD)
        angles[2 * k + 1, k] = min(upper[k], _SAMPLE_RAD)
    positions = np.zeros((len(angles), arm.joints.stop))
    positions[:, arm.first : arm.first + count] = angles * arm.radius[:count]
    return positions


def _find_axes_across(frames: Array) -> NDArray[np.int64]:
    """Return for each frame which two of its axes lie most across the arm."""
    points = frames[:, :3, 3]
    steps = np.diff(points, axis=0, append=points[-1:])
    for k in range(len(steps) - 1, 0, -1):  # frames in one place share the way that leads there
        if np.linalg.norm(steps[k]) < 1e-9:
            steps[k] = points[k] - points[k - 1]
    local = np.abs(np.einsum("nij,ni->nj", frames[:, :3, :3], steps))
    return np.sort(np.argsort(local, axis=1, kind="stable")[:, :2], axis=1)


def _read_hands(document: ConfigDocument) -> list[HandAxes]:
    """Return the hands in space that the master's section states; it is checked by the master."""
    master = document.tree.get("master")
    mapping = master.get("mapping") if isinstance(master, dict) else None
    if not isinstance(mapping, dict) or mapping.get("type") != "space":
        return []
    hands: list[HandAxes] = []
    first = 0
    try:
        for hand in mapping.get("hands") or [_DEFAULT_HAND]:
            names = tuple(hand.get("axes", _TRANSLATIONS))
            roll, pitch, yaw = hand.get("registration", (0.0, 0.0, 0.0))
            rotation = Offset(rpy=(roll, pitch, yaw)).to_matrix()[:3, :3]
            hands.append(HandAxes(first, names, rotation))
            first += len(names)
    except (AttributeError, TypeError, ValueError) as error:  # the master's classes are not ours
        raise document.build_error(
            ("master", "mapping", "hands"),
            "must be a list of hands, with axes as [x, y, z] and registration as three angles",
        ) from error
    return hands
