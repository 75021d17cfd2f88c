"""The frames of the sheaths' ends, from their shapes. Pure.

`sheath_N_housing` lies in the frame `housing`, one beside the other; `sheath_N_tip` is the other
end of the sheath as the config describes it, its x axis along the sheath and away from the housing.
`tip_J` is that of the first tendon of joint J, in which the force of the joint is given.
"""

import math
from collections.abc import Mapping

import numpy as np

from estimator.array_types import Array
from teleop.messages.messages import MAX_SECTIONS, Event, LoopReport, Sheath, decode_text
from teleop.messages.topics import Role
from teleop.ros.outputs import build_frame_name
from teleop.ros.standard import (
    DiagnosticArray,
    DiagnosticStatus,
    Header,
    KeyValue,
    Quaternion,
    TFMessage,
    Time,
    Transform,
    TransformStamped,
    Vector3,
)
from teleop.session.state_machine import State, to_reason
from teleop.view.shape import compute_centreline

HOUSING_SPACING_M = 0.02  # [m] between the housings of two sheaths


def build_sheath_frames(sheaths: Mapping[int, Sheath], stamp_ns: int, prefix: str) -> TFMessage:
    """Return the transforms of all known sheaths, by number of the tendon from 0."""
    found, seen = [], set[int]()
    stamp = Time.of(stamp_ns)

    def add(parent: str, child: str, place: Transform) -> None:
        parent, child = build_frame_name(prefix, parent), build_frame_name(prefix, child)
        found.append(TransformStamped(Header(stamp, parent), child, place))

    for tendon in sorted(sheaths):
        sheath, name = sheaths[tendon], f"sheath_{tendon + 1}"
        add("housing", f"{name}_housing", Transform(Vector3(y=HOUSING_SPACING_M * tendon)))
        add(f"{name}_housing", f"{name}_tip", compute_tip_transform(sheath))
        if sheath.joint not in seen:
            seen.add(sheath.joint)
            add(f"{name}_tip", f"tip_{sheath.joint + 1}", Transform())
    return TFMessage(tuple(found))


def compute_tip_transform(sheath: Sheath) -> Transform:
    """Return the place of a sheath's tip in the frame of its housing."""
    n = min(sheath.sections, MAX_SECTIONS)
    length, radius = np.array(sheath.section_length[:n]), np.array(sheath.section_radius[:n])
    if not (length.sum() > 0.0 and np.isfinite(length).all()):
        return Transform()
    line = compute_centreline(length, radius, np.array([length.sum()]))
    x, y, z = line.points[-1].tolist()
    axes = np.stack([line.along, line.aside, np.cross(line.along, line.aside)], axis=1)
    return Transform(Vector3(x, y, z), to_quaternion(axes))


def to_quaternion(rotation: Array) -> Quaternion:
    """Return the unit quaternion of a rotation matrix, by the largest component (Shepperd 1978)."""
    trace = float(np.trace(rotation))
    squares = [trace, *np.diag(rotation).tolist()]
    largest = int(np.argmax(squares))
    if largest == 0:
        w = math.sqrt(max(0.0, 1.0 + trace)) / 2
        x, y, z = (
            (rotation[2, 1] - rotation[1, 2]) / (4 * w),
            (rotation[0, 2] - rotation[2, 0]) / (4 * w),
            (rotation[1, 0] - rotation[0, 1]) / (4 * w),
        )
        return Quaternion(float(x), float(y), float(z), w)
    i = largest - 1
    j, k = (i + 1) % 3, (i + 2) % 3
    size = math.sqrt(max(0.0, 1.0 + rotation[i, i] - rotation[j, j] - rotation[k, k])) / 2
    parts = [0.0, 0.0, 0.0]
    parts[i] = size
    parts[j] = float(rotation[j, i] + rotation[i, j]) / (4 * size)
    parts[k] = float(rotation[k, i] + rotation[i, k]) / (4 * size)
    w = float(rotation[k, j] - rotation[j, k]) / (4 * size)
    return Quaternion(parts[0], parts[1], parts[2], w)


# --- diagnostics for ROS: the state of both sides, from their reports and events. Pure

OK, WARN, ERROR, STALE = range(4)  # levels of diagnostic_msgs/msg/DiagnosticStatus
SILENT_NS = 2_000_000_000  # [ns] without a report, which come twice a second
_LEVELS = {State.FAULT: ERROR, State.STOPPED: ERROR, State.HOLDING: WARN, State.OFF: WARN}
_COUNTS = (
    "ticks", "overruns", "received", "lost", "rejected", "corrupted", "repeated", "out_of_order",
    "foreign", "forged", "unknown", "delayed", "clock_jumps", "restarts",
)  # fmt: skip
SIDES = (Role.MASTER, Role.SLAVE)


def build_diagnostics(
    session: str,
    reports: Mapping[Role, tuple[LoopReport, int]],
    events: Mapping[Role, Event],
    now_ns: int,
    refused: str = "",
) -> DiagnosticArray:
    """Return the status of both sides.

    Parameters
    ----------
    session : str
        Name of the session.
    reports : mapping
        Newest report of each side, and when it was received [ns].
    events : mapping
        Newest event of each side.
    now_ns : int
        Present stamp [ns].
    refused : str
        Why commands of ROS nodes are refused; empty if there are none.
    """
    status = [
        _build_status(session, role, reports.get(role), events.get(role), now_ns) for role in SIDES
    ]
    if refused:
        status.append(DiagnosticStatus(WARN, "teleop: ros", refused, session))
    return DiagnosticArray(Header(Time.of(now_ns)), tuple(status))


def _build_status(
    session: str,
    role: Role,
    report: tuple[LoopReport, int] | None,
    event: Event | None,
    now_ns: int,
) -> DiagnosticStatus:
    name = f"teleop: {role.name.lower()}"
    if report is None or now_ns - report[1] > SILENT_NS:
        return DiagnosticStatus(STALE, name, "no reports", session)
    latest = report[0]
    state, reason = State(latest.state), to_reason(latest.reason)
    values = [
        KeyValue("state", state.name.lower()),
        KeyValue("rate_hz", f"{latest.rate_hz:.1f}"),
        KeyValue("lateness_max_ms", f"{latest.lateness_max_ns * 1e-6:.3f}"),
        *(KeyValue(key, str(getattr(latest, key))) for key in _COUNTS),
    ]
    if latest.latency_p50_ns:
        values.append(KeyValue("latency_p50_ms", f"{latest.latency_p50_ns * 1e-6:.3f}"))
        values.append(KeyValue("latency_p99_ms", f"{latest.latency_p99_ns * 1e-6:.3f}"))
    if event is not None:
        values.append(KeyValue("event", decode_text(event.text)))
    level = _LEVELS.get(state, OK)
    return DiagnosticStatus(level, name, reason.text, session, tuple(values))
