"""Arms in ROS: joints under the names of the URDF, links as frames, pose and force of the tip.

A frame is named as its link, below `arm_N` where there is more than one arm. The frame of the base
is the root of an arm's own tree.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

import numpy as np

from estimator.array_types import Array
from teleop.config.arm import ArmConfig
from teleop.config.loading import ConfigDocument
from teleop.messages.messages import SlaveState
from teleop.ros.frames import build_frame_transform, to_quaternion
from teleop.ros.message_types import (
    POINT,
    POSE,
    POSE_STAMPED,
    VECTOR3,
    WRENCH,
    WRENCH_STAMPED,
    build_header,
    build_message,
)
from teleop.ros.output_topics import build_frame_name
from teleop.view.space_arm import SpaceArm, load_arms

GRIPPER = "gripper"  # the joint behind the kinematics


@dataclass(frozen=True, slots=True)
class RosArm:
    """An arm with the names of its joints and frames: the base, the end of each part, the tip."""

    space: SpaceArm
    joints: tuple[str, ...]
    frames: tuple[str, ...]

    def compute_poses(self, travel: Sequence[float]) -> Array | None:
        """Return the poses of its frames in the base, shape (frames, 4, 4); None if unknown.

        `travel` [m] is that of all joints of the slave.
        """
        from estimator.kinematics.forward import compute_part_frames

        positions = np.array([travel], np.float64)
        if not np.isfinite(positions[:, self.space.joints]).all():
            return None
        angles = self.space.get_angles(positions)[0]
        return compute_part_frames(self.space.prepared, angles, 1)[0][: len(self.frames)]

    def build_tip_pose(self, travel: Sequence[float], stamp_ns: int, prefix: str) -> Any | None:
        """Return the pose of the tip in the base, a PoseStamped; None if it is unknown."""
        poses = self.compute_poses(travel)
        if poses is None:
            return None
        x, y, z = poses[-1, :3, 3].tolist()
        return build_message(
            POSE_STAMPED,
            header=build_header(stamp_ns, build_frame_name(prefix, self.frames[0])),
            pose=build_message(
                POSE,
                position=build_message(POINT, x=x, y=y, z=z),
                orientation=to_quaternion(poses[-1, :3, :3]),
            ),
        )

    def build_tip_force(self, state: SlaveState, prefix: str) -> Any | None:
        """Return the force on the tip in its frame, a WrenchStamped; None if it is unknown."""
        poses = self.compute_poses(state.position)
        if poses is None:
            return None
        names = ("position", "force", "force_low", "force_high")
        rows = np.zeros(1, [(name, "f8", len(state.position)) for name in names])
        for name in names:
            rows[name] = getattr(state, name)
        force = poses[-1, :3, :3].T @ self.space.estimate_tip_forces(rows).force[0]
        if not np.isfinite(force).all():
            return None
        x, y, z = force.tolist()
        return build_message(
            WRENCH_STAMPED,
            header=build_header(state.stamp_ns, build_frame_name(prefix, self.frames[-1])),
            wrench=build_message(WRENCH, force=build_message(VECTOR3, x=x, y=y, z=z)),
        )

    def build_transforms(self, travel: Sequence[float], stamp_ns: int, prefix: str) -> list[Any]:
        """Return a TransformStamped from each of its frames to the next; none if unknown."""
        poses = self.compute_poses(travel)
        if poses is None:
            return []
        steps = np.linalg.inv(poses[:-1]) @ poses[1:]
        return [
            build_frame_transform(prefix, self.frames[k], self.frames[k + 1], stamp_ns, step)
            for k, step in enumerate(steps)
        ]


def load_ros_arms(document: ConfigDocument, configs: Sequence[ArmConfig]) -> tuple[RosArm, ...]:
    """Return the arms of a session that have kinematics."""
    spaces = {arm.first: arm for arm in load_arms(document, configs)}
    arms: list[RosArm] = []
    first = 0
    for number, config in enumerate(configs, 1):
        if first in spaces:
            prefix = f"arm_{number}/" if len(configs) > 1 else ""
            arms.append(_name_arm(spaces[first], config, prefix))
        first += config.joints
    return tuple(arms)


def _name_arm(space: SpaceArm, config: ArmConfig, prefix: str) -> RosArm:
    arm = config.load_kinematics()
    joints = [coordinate.name for coordinate in arm.coordinates] + [GRIPPER] * space.has_gripper
    frames = ["base", *(part.name for part in arm.parts), "tip"]
    if config.urdf is not None:  # each part is a joint, its frame that of the link behind it
        tree = ElementTree.fromstring(config.urdf.read_bytes())  # noqa: S314 - it was read before
        ends = {joint.get("name"): joint for joint in tree.iterfind("joint")}
        chain = [ends[part.name] for part in arm.parts]
        frames = [_get_link(chain[0], "parent"), *(_get_link(joint, "child") for joint in chain)]
    return RosArm(
        space, tuple(prefix + name for name in joints), tuple(prefix + name for name in frames)
    )


def _get_link(joint: ElementTree.Element, end: str) -> str:
    """Return the link at an end of a joint of a URDF."""
    found = joint.find(end)
    return "" if found is None else found.get("link", "")
