"""The frames of the sheaths' ends, from their shapes. Pure.

`sheath_N_housing` lies in the frame `housing`, one beside the other; `sheath_N_tip` is the other
end of the sheath as the config describes it, its x axis along the sheath and away from the housing.
`tip_J` is that of the first tendon of joint J, in which the force of the joint is given.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from estimator.array_types import Array
from teleop.link.reception import REPORTED_COUNTERS
from teleop.messages.messages import MAX_MESSAGE_SECTIONS, Event, LoopReport, Sheath, decode_text
from teleop.messages.topics import Role
from teleop.ros.message_types import (
    DIAGNOSTIC_ARRAY,
    DIAGNOSTIC_STATUS,
    KEY_VALUE,
    QUATERNION,
    TF_MESSAGE,
    TRANSFORM,
    TRANSFORM_STAMPED,
    VECTOR3,
    build_header,
    build_message,
)
from teleop.ros.output_topics import build_frame_name
from teleop.session.state_machine import State, to_reason
from teleop.view.scene_geometry import compute_centreline

HOUSING_SPACING_M = 0.02  # [m] between the housings of two sheaths


def build_sheath_frames(sheaths: Mapping[int, Sheath], stamp_ns: int, prefix: str) -> Any:
    """Return the transforms of all known sheaths as a TFMessage, by number of the tendon from 0."""
    frames, added = [], set[int]()

    def add(parent: str, child: str, pose: Array) -> None:
        frames.append(build_frame_transform(prefix, parent, child, stamp_ns, pose))

    for tendon in sorted(sheaths):
        sheath, name = sheaths[tendon], f"sheath_{tendon + 1}"
        offset = np.eye(4)
        offset[1, 3] = HOUSING_SPACING_M * tendon
        add("housing", f"{name}_housing", offset)
        add(f"{name}_housing", f"{name}_tip", compute_tip_pose(sheath))
        if sheath.joint not in added:
            added.add(sheath.joint)
            add(f"{name}_tip", f"tip_{sheath.joint + 1}", np.eye(4))
    return build_message(TF_MESSAGE, transforms=frames)


def build_frame_transform(prefix: str, parent: str, child: str, stamp_ns: int, pose: Array) -> Any:
    """Return the `pose` of a frame in its parent, shape (4, 4), as a TransformStamped."""
    x, y, z = pose[:3, 3].tolist()
    return build_message(
        TRANSFORM_STAMPED,
        header=build_header(stamp_ns, build_frame_name(prefix, parent)),
        child_frame_id=build_frame_name(prefix, child),
        transform=build_message(
            TRANSFORM,
            translation=build_message(VECTOR3, x=x, y=y, z=z),
            rotation=to_quaternion(pose[:3, :3]),
        ),
    )


def compute_tip_pose(sheath: Sheath) -> Array:
    """Return the pose of a sheath's tip in the frame of its housing, shape (4, 4)."""
    n = min(sheath.sections, MAX_MESSAGE_SECTIONS)
    length, radius = np.array(sheath.section_length[:n]), np.array(sheath.section_radius[:n])
    pose = np.eye(4)
    if length.sum() > 0.0 and np.isfinite(length).all():
        line = compute_centreline(length, radius, np.array([length.sum()]))
        axes = (line.along, line.aside, np.cross(line.along, line.aside))
        pose[:3, :3], pose[:3, 3] = np.stack(axes, axis=1), line.points[-1]
    return pose


def to_quaternion(rotation: Array) -> Any:
    """Return the unit Quaternion of a rotation matrix."""
    x, y, z, w = Rotation.from_matrix(rotation).as_quat().tolist()
    return build_message(QUATERNION, x=x, y=y, z=z, w=w)


# --- diagnostics for ROS: the state of both sides, from their reports and events. Pure

OK, WARN, ERROR, STALE = range(4)  # levels of diagnostic_msgs/msg/DiagnosticStatus
SILENT_NS = 2_000_000_000  # [ns] without a report, which come twice a second
_LEVELS = {State.FAULT: ERROR, State.STOPPED: ERROR, State.HOLDING: WARN, State.OFF: WARN}
SIDES = (Role.MASTER, Role.SLAVE)


class SessionNotes:
    """The newest reports and events of both sides, and the sheaths, for diagnostics and frames."""

    def __init__(self) -> None:
        self.sheaths: dict[int, Sheath] = {}  # by number of the tendon from 0
        self.reports: dict[Role, tuple[LoopReport, int]] = {}  # and when it was received [ns]
        self.events: dict[Role, Event] = {}

    def add(self, message: Sheath | LoopReport | Event, received_ns: int) -> None:
        """Take a message; what neither side sent is left out."""
        if isinstance(message, Sheath):
            self.sheaths[message.tendon] = message
        elif message.role not in SIDES:
            return
        elif isinstance(message, LoopReport):
            self.reports[Role(message.role)] = message, received_ns
        else:
            self.events[Role(message.role)] = message


def build_diagnostics(session: str, notes: SessionNotes, now_ns: int, refused: str = "") -> Any:
    """Return the status of both sides at the stamp `now_ns` [ns], a DiagnosticArray.

    `refused` says why commands of ROS nodes are refused, empty if there are none.
    """
    status = [_build_status(session, role, notes, now_ns) for role in SIDES]
    if refused:
        status.append(_build_status_message(WARN, "teleop: ros", refused, session))
    return build_message(DIAGNOSTIC_ARRAY, header=build_header(now_ns), status=status)


def _build_status(session: str, role: Role, notes: SessionNotes, now_ns: int) -> Any:
    report, name = notes.reports.get(role), f"teleop: {role.name.lower()}"
    if report is None or now_ns - report[1] > SILENT_NS:
        return _build_status_message(STALE, name, "no reports", session)
    latest = report[0]
    state, reason = State(latest.state), to_reason(latest.reason)
    values = {
        "state": state.name.lower(),
        "rate_hz": f"{latest.rate_hz:.1f}",
        "lateness_max_ms": f"{latest.lateness_max_ns * 1e-6:.3f}",
        **{key: str(getattr(latest, key)) for key in ("ticks", "overruns", *REPORTED_COUNTERS)},
    }
    if latest.latency_p50_ns:
        values["latency_p50_ms"] = f"{latest.latency_p50_ns * 1e-6:.3f}"
        values["latency_p99_ms"] = f"{latest.latency_p99_ns * 1e-6:.3f}"
    if (event := notes.events.get(role)) is not None:
        values["event"] = decode_text(event.text)
    return _build_status_message(_LEVELS.get(state, OK), name, reason.text, session, values)


def _build_status_message(
    level: int, name: str, text: str, session: str, values: Mapping[str, str] | None = None
) -> Any:
    return build_message(
        DIAGNOSTIC_STATUS,
        level=level,
        name=name,
        message=text,
        hardware_id=session,
        values=[build_message(KEY_VALUE, key=k, value=v) for k, v in (values or {}).items()],
    )
