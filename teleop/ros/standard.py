"""The message types of others that are sent or read here, as declared by their packages.

`builtin_interfaces`, `std_msgs`, `geometry_msgs`, `sensor_msgs`, `diagnostic_msgs` and `tf2_msgs`
are those of Jazzy and Rolling; `crtk_msgs` is the Collaborative Robotics Toolkit's
(github.com/collaborative-robotics/crtk_msgs). Constants and default values are left out: they are
part neither of the bytes nor of the type hash.
"""

from dataclasses import dataclass, field
from typing import ClassVar

from teleop.ros.interface import Bool, Byte, Float64, Float64s, Int32, Text, Texts, UInt32


@dataclass(frozen=True, slots=True)
class Time:
    """A time: seconds and nanoseconds since the Unix epoch."""

    ros_name: ClassVar[str] = "builtin_interfaces/msg/Time"
    sec: Int32 = 0
    nanosec: UInt32 = 0

    @classmethod
    def of(cls, stamp_ns: int) -> "Time":
        """Return the time of a stamp [ns]; one outside the 32 bits of seconds is zero."""
        sec, nanosec = divmod(stamp_ns, 1_000_000_000)
        return cls(sec, nanosec) if -(2**31) <= sec < 2**31 else cls()

    @property
    def ns(self) -> int:
        """The time as a stamp [ns]."""
        return self.sec * 1_000_000_000 + self.nanosec


@dataclass(frozen=True, slots=True)
class Header:
    """Time and coordinate frame of a message."""

    ros_name: ClassVar[str] = "std_msgs/msg/Header"
    stamp: Time = field(default_factory=Time)
    frame_id: Text = ""


@dataclass(frozen=True, slots=True)
class JointState:
    """Positions [m, rad], velocities and efforts [N, N m] of joints; an empty list = unknown."""

    ros_name: ClassVar[str] = "sensor_msgs/msg/JointState"
    header: Header = field(default_factory=Header)
    name: Texts = ()
    position: Float64s = ()
    velocity: Float64s = ()
    effort: Float64s = ()


@dataclass(frozen=True, slots=True)
class Vector3:
    """A vector."""

    ros_name: ClassVar[str] = "geometry_msgs/msg/Vector3"
    x: Float64 = 0.0
    y: Float64 = 0.0
    z: Float64 = 0.0


@dataclass(frozen=True, slots=True)
class Quaternion:
    """A rotation as a unit quaternion."""

    ros_name: ClassVar[str] = "geometry_msgs/msg/Quaternion"
    x: Float64 = 0.0
    y: Float64 = 0.0
    z: Float64 = 0.0
    w: Float64 = 1.0


@dataclass(frozen=True, slots=True)
class Wrench:
    """Force [N] and torque [N m]."""

    ros_name: ClassVar[str] = "geometry_msgs/msg/Wrench"
    force: Vector3 = field(default_factory=Vector3)
    torque: Vector3 = field(default_factory=Vector3)


@dataclass(frozen=True, slots=True)
class WrenchStamped:
    """Force and torque in a frame."""

    ros_name: ClassVar[str] = "geometry_msgs/msg/WrenchStamped"
    header: Header = field(default_factory=Header)
    wrench: Wrench = field(default_factory=Wrench)


@dataclass(frozen=True, slots=True)
class Twist:
    """Linear [m/s] and angular velocity [rad/s]."""

    ros_name: ClassVar[str] = "geometry_msgs/msg/Twist"
    linear: Vector3 = field(default_factory=Vector3)
    angular: Vector3 = field(default_factory=Vector3)


@dataclass(frozen=True, slots=True)
class TwistStamped:
    """Velocity in a frame."""

    ros_name: ClassVar[str] = "geometry_msgs/msg/TwistStamped"
    header: Header = field(default_factory=Header)
    twist: Twist = field(default_factory=Twist)


@dataclass(frozen=True, slots=True)
class Transform:
    """Translation [m], then rotation, of a frame in its parent."""

    ros_name: ClassVar[str] = "geometry_msgs/msg/Transform"
    translation: Vector3 = field(default_factory=Vector3)
    rotation: Quaternion = field(default_factory=Quaternion)


@dataclass(frozen=True, slots=True)
class TransformStamped:
    """A transform between two named frames."""

    ros_name: ClassVar[str] = "geometry_msgs/msg/TransformStamped"
    header: Header = field(default_factory=Header)
    child_frame_id: Text = ""
    transform: Transform = field(default_factory=Transform)


@dataclass(frozen=True, slots=True)
class TFMessage:
    """Transforms, as on `/tf`."""

    ros_name: ClassVar[str] = "tf2_msgs/msg/TFMessage"
    transforms: tuple[TransformStamped, ...] = ()


@dataclass(frozen=True, slots=True)
class KeyValue:
    """A value of a diagnostic status, as text."""

    ros_name: ClassVar[str] = "diagnostic_msgs/msg/KeyValue"
    key: Text = ""
    value: Text = ""


@dataclass(frozen=True, slots=True)
class DiagnosticStatus:
    """Status of one component; level 0 = ok, 1 = warning, 2 = error, 3 = stale."""

    ros_name: ClassVar[str] = "diagnostic_msgs/msg/DiagnosticStatus"
    level: Byte = 0
    name: Text = ""
    message: Text = ""
    hardware_id: Text = ""
    values: tuple[KeyValue, ...] = ()


@dataclass(frozen=True, slots=True)
class DiagnosticArray:
    """Status of components, as on `/diagnostics`."""

    ros_name: ClassVar[str] = "diagnostic_msgs/msg/DiagnosticArray"
    header: Header = field(default_factory=Header)
    status: tuple[DiagnosticStatus, ...] = ()


@dataclass(frozen=True, slots=True)
class OperatingState:
    """CRTK's state of a robot: DISABLED, ENABLED, PAUSED or FAULT."""

    ros_name: ClassVar[str] = "crtk_msgs/msg/OperatingState"
    header: Header = field(default_factory=Header)
    state: Text = ""
    is_homed: Bool = False
    is_busy: Bool = False


@dataclass(frozen=True, slots=True)
class StringStamped:
    """CRTK's commands of state: enable, disable, pause, resume."""

    ros_name: ClassVar[str] = "crtk_msgs/msg/StringStamped"
    header: Header = field(default_factory=Header)
    string: Text = ""
