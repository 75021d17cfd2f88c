"""Diagnostics for ROS: the state of both sides, from their reports and events. Pure."""

from collections.abc import Mapping

from teleop.messages.messages import Event, LoopReport, decode_text
from teleop.messages.topics import Role
from teleop.ros.standard import DiagnosticArray, DiagnosticStatus, Header, KeyValue, Time
from teleop.session.state_machine import State, to_reason

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
