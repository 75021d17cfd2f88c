"""Configs of how a hand's axes move the joints; null in a master's config: axis k moves joint k."""

from dataclasses import dataclass, field
from typing import Literal

from estimator.kinematics.inverse import InverseConfig
from estimator.kinematics.virtual_fixtures import FixturesConfig
from teleop.config.ranges import build_ranged_field, check_ranges
from teleop.messages.messages import MAX_JOINTS

# --- axes of the device assigned to joints


@dataclass(frozen=True, slots=True)
class MappedJointConfig:
    """Which axis of the device moves a joint, and how."""

    # counted from 0; null = the joint is not moved
    axis: int | None = build_ranged_field(None, 0, MAX_JOINTS - 1)
    # the axis turns: it is read in rad below, and gets a torque [N m], bounded by gate.torque_max
    turns: bool = False
    scale: float = 1.0  # times operator.position_scale; negative = the other way; m/rad if it turns
    # of the hand around 0 that moves nothing
    dead_band: float = build_ranged_field(0.0, 0.0, 0.1, "m")
    # [m] of the hand; beyond it the joint stays, to which it comes to rest within the last tenth
    range: tuple[float, float] = (-1.0, 1.0)

    def __post_init__(self) -> None:
        check_ranges(self)
        if not 0.0 < abs(self.scale) <= 100.0:
            raise ValueError("scale: must not be 0, and at most 100 either way")
        if not self.range[0] < 0.0 < self.range[1]:
            raise ValueError("range: must be [from, to] of the hand, with 0 between them")


@dataclass(frozen=True, slots=True)
class AxisMapConfig:
    """Axes of the device assigned to joints."""

    type: Literal["axes"] = "axes"
    joints: tuple[MappedJointConfig, ...] = (MappedJointConfig(axis=0),)  # one for each joint

    def __post_init__(self) -> None:
        """Check the number of joints; raises `ValueError`."""
        if not 1 <= len(self.joints) <= MAX_JOINTS:
            raise ValueError(f"joints: must be 1 to {MAX_JOINTS}")
        for j, joint in enumerate(self.joints):
            if any(
                joint.axis == other.axis and joint.turns != other.turns for other in self.joints
            ):
                raise ValueError(f"joints.{j}.turns: must be the same for all joints of an axis")


# --- a hand in space that moves the tip of an arm

HandAxis = Literal["x", "y", "z", "roll", "pitch", "yaw", "grip"]
HAND_AXES: tuple[HandAxis, ...] = ("x", "y", "z", "roll", "pitch", "yaw", "grip")


@dataclass(frozen=True, slots=True)
class SpaceHandConfig:
    """How a hand moves the tip of one arm."""

    # what the device's axes are, in its order; the next hand has those that follow
    axes: tuple[HandAxis, ...] = ("x", "y", "z")
    # of each of `axes` beside the others; negative = the other way
    scales: tuple[float, ...] = build_ranged_field((), -100.0, 100.0)
    # [m], [rad] of each around 0 that move nothing
    dead_bands: tuple[float, ...] = build_ranged_field((), 0.0, 100.0)
    # rotation of the tip over that of the hand
    rotation_scale: float = build_ranged_field(1.0, 0.0, 10.0, above=True)
    grip_scale: float = 1.0  # travel of the gripper's joint over that of the grip axis
    # [rad] roll, pitch, yaw of the device in the frame of the arm's base, or of the camera
    registration: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lock: tuple[HandAxis, ...] = ()  # that move nothing
    align_orientation: bool = False  # the tip turns until it has the hand's orientation
    # [rad] before its limit within which a joint comes to rest; [m] times rotation_length
    stop_distance: float = build_ranged_field(0.05, 1e-4, 0.5, "rad")
    inverse: InverseConfig = field(default_factory=InverseConfig)  # of the kinematics
    fixtures: FixturesConfig = field(default_factory=FixturesConfig)  # springs in the hand

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.axes or len(set(self.axes)) != len(self.axes):
            raise ValueError(f"axes: each at most once, of {', '.join(HAND_AXES)}")
        for name in ("scales", "dead_bands"):
            if len(getattr(self, name)) not in (0, len(self.axes)):
                raise ValueError(f"{name}: must be one number for each of axes ({len(self.axes)})")
        if 0.0 in self.scales:
            raise ValueError("scales: must not be 0; name axes that move nothing under lock")
        if not 0.0 < abs(self.grip_scale) <= 100.0:
            raise ValueError("grip_scale: must not be 0, and at most 100 either way")
        rotations = {"roll", "pitch", "yaw"} - set(self.lock)
        if self.align_orientation and (
            self.rotation_scale != 1.0 or len(rotations & set(self.axes)) < 3
        ):
            raise ValueError(
                "align_orientation: needs rotation_scale 1 and roll, pitch, yaw, none of them "
                "locked"
            )


@dataclass(frozen=True, slots=True)
class SpaceMapConfig:
    """Hands in space: one for each arm, in their order."""

    type: Literal["space"] = "space"
    hands: tuple[SpaceHandConfig, ...] = (SpaceHandConfig(),)  # as many as arms

    def __post_init__(self) -> None:
        """Check the number of hands; raises `ValueError`."""
        if not self.hands:
            raise ValueError("hands: at least one is needed")


MappingConfig = AxisMapConfig | SpaceMapConfig
