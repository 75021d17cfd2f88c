"""Message types of ROS 2: their declarations, bytes (CDR) and hashes (RIHS01), by `rosbags`.

A type is named as ROS names it, such as `sensor_msgs/msg/JointState`. `rosbags` brings those of
Jazzy; `crtk_msgs` is the Collaborative Robotics Toolkit's
(github.com/collaborative-robotics/crtk_msgs), and the messages of `teleop.messages.messages` are
types of the package `tendon_teleop`. `rosbags` is in the optional extra `ros` and imported when the
first message is built, encoded or decoded.
"""

import struct
from collections.abc import Iterable, Sequence
from functools import cache
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

from teleop.errors import TeleopError, UsageError
from teleop.messages.messages import ENCAPSULATION, MESSAGES, SCHEMA_PACKAGE, Message

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

TIME = "builtin_interfaces/msg/Time"
HEADER = "std_msgs/msg/Header"
JOINT_STATE = "sensor_msgs/msg/JointState"
VECTOR3 = "geometry_msgs/msg/Vector3"
QUATERNION = "geometry_msgs/msg/Quaternion"
POINT = "geometry_msgs/msg/Point"
POSE = "geometry_msgs/msg/Pose"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
WRENCH = "geometry_msgs/msg/Wrench"
WRENCH_STAMPED = "geometry_msgs/msg/WrenchStamped"
TWIST = "geometry_msgs/msg/Twist"
TWIST_STAMPED = "geometry_msgs/msg/TwistStamped"
TRANSFORM = "geometry_msgs/msg/Transform"
TRANSFORM_STAMPED = "geometry_msgs/msg/TransformStamped"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
KEY_VALUE = "diagnostic_msgs/msg/KeyValue"
DIAGNOSTIC_STATUS = "diagnostic_msgs/msg/DiagnosticStatus"
DIAGNOSTIC_ARRAY = "diagnostic_msgs/msg/DiagnosticArray"
OPERATING_STATE = "crtk_msgs/msg/OperatingState"
STRING_STAMPED = "crtk_msgs/msg/StringStamped"
_CRTK = {
    OPERATING_STATE: "std_msgs/Header header\nstring state\nbool is_homed\nbool is_busy\n",
    STRING_STAMPED: "std_msgs/Header header\nstring string\n",
}

MISSING_EXTRA = "ROS 2 needs the Python package rosbags: pip install 'tendon-teleop[ros]'"
_LENGTH_MAX = 100_000  # elements of a sequence: more is damage
_BYTES_MAX = 1 << 22  # [bytes] of a message: more is damage
# rclpy pads the empty sequences of a message in the length of its buffer, but not in its content: a
# JointState without positions and velocities has 12 further bytes of no meaning
_TRAILING_BYTES_MAX = 16


class CdrError(TeleopError):
    """Bytes that are no message of the expected type."""


def require_rosbags() -> None:
    """Raise `UsageError` with the remedy if `rosbags` is not installed."""
    if find_spec("rosbags") is None:
        raise UsageError(MISSING_EXTRA)


@cache
def load_typestore() -> "Typestore":
    """Return all types; `UsageError` if `rosbags` is not installed."""
    require_rosbags()
    from rosbags.typesys import get_types_from_msg
    from rosbags.typesys.store import Typestore
    from rosbags.typesys.stores import ros2_jazzy

    store = Typestore(ros2_jazzy, max_sequence_length=_LENGTH_MAX)
    ours = {to_type_name(cls): cls.schema.ros_definition for cls in MESSAGES}
    for name, text in (_CRTK | ours).items():
        store.register(get_types_from_msg(text, name))
    return store


def to_type_name(cls: type[Message]) -> str:
    """Return the name of the type of a message of ours."""
    return f"{SCHEMA_PACKAGE}/msg/{cls.schema.name}"


@cache
def compute_type_hash(name: str) -> str:
    """Return the hash of a type, `RIHS01_` and 64 hexadecimal digits."""
    return load_typestore().hash_rihs01(name)


def format_definition(name: str) -> str:
    """Return the `.msg` text of a type with those that it refers to, as MCAP's `ros2msg` wants."""
    return load_typestore().generate_msgdef(name, ros_version=2)[0]


def encode(message: Any) -> bytes:
    """Return the bytes of a message, little-endian CDR."""
    data = load_typestore().serialize_cdr(message, message.__msgtype__, little_endian=True)
    return data.tobytes()


def decode(name: str, data: bytes) -> Any:
    """Return the message of type `name` in `data`.

    Raises `CdrError` if it is too short or long, no little-endian CDR, or has text that is not
    UTF-8.
    """
    from rosbags.serde import SerdeError

    if data[:2] != ENCAPSULATION[:2]:
        raise CdrError("not little-endian CDR")
    if len(data) > _BYTES_MAX:
        raise CdrError(f"{len(data)} bytes, at most {_BYTES_MAX} are read")
    store = load_typestore()
    definition = store.get_msgdef(name)
    body = memoryview(data)[len(ENCAPSULATION) :]
    try:
        # `Typestore.deserialize_cdr` refuses the further bytes of rclpy
        message, end = definition.deserialize_cdr_le(body, 0, definition.cls, store)
    except (SerdeError, struct.error, ValueError) as error:  # text that is not UTF-8 is the last
        raise CdrError(f"{name}: {error}") from error
    if len(body) - end > _TRAILING_BYTES_MAX:
        raise CdrError(f"{len(body) - end} bytes too long for {name}")
    return message


def build_message(type_name: str, /, **fields: Any) -> Any:
    """Return a message; fields that are not given are zero or empty."""
    return load_typestore().types[type_name](**(_build_default_fields(type_name) | fields))


@cache
def _build_default_fields(name: str) -> dict[str, Any]:
    from rosbags.interfaces import Nodetype

    values: dict[str, Any] = {}
    for field, (kind, detail) in load_typestore().fielddefs[name][1]:
        if kind == Nodetype.NAME:
            values[field] = build_message(str(detail))
        elif kind == Nodetype.BASE:
            values[field] = "" if detail[0] == "string" else 0
        else:
            values[field] = ()
    return values


def build_header(stamp_ns: int, frame_id: str = "") -> Any:
    """Return a header; a stamp [ns] outside the 32 bits of seconds is zero."""
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    if not -(2**31) <= sec < 2**31:
        sec, nanosec = 0, 0
    return build_message(
        HEADER, stamp=build_message(TIME, sec=sec, nanosec=nanosec), frame_id=frame_id
    )


def build_joint_state(
    header: Any,
    name: Sequence[str] = (),
    position: Iterable[float] = (),
    velocity: Iterable[float] = (),
    effort: Iterable[float] = (),
) -> Any:
    """Return a JointState: m or rad, their velocities, N or N m; an empty list = unknown."""
    return build_message(
        JOINT_STATE,
        header=header,
        name=name,
        position=np.array(position, np.float64),
        velocity=np.array(velocity, np.float64),
        effort=np.array(effort, np.float64),
    )


def to_stamp_ns(header: Any) -> int:
    """Return the stamp of a header [ns]."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)
