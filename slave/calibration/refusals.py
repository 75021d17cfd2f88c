"""Messages of an aborted calibration: one line with the tendon, the observation and a remedy."""

from slave.calibration.config import InitialiseConfig
from slave.gate import GateFlags

TENDON_NAMES = ("a", "b")


def format_tendon_name(joint: int, tendons: int, tendon: int) -> str:
    """Return the name of a tendon in messages: joints count from 1, tendons are a and b."""
    return f"joint {joint}, tendon {TENDON_NAMES[tendon]}" if tendons > 1 else f"joint {joint}"


def format_phase_timeout(joint: int, action: str, config: InitialiseConfig) -> str:
    """Message: a phase did not end."""
    return (
        f"joint {joint}: {action} took longer than {config.phase_max:g} s; check what blocks it, "
        "or raise slave.initialise.phase_max"
    )


def format_blocked_motor(name: str, verdict: GateFlags, request: float, seeking: bool) -> str:
    """Message: a limit of the gate blocks a motor; the sign of `request` [m] is the direction."""
    if GateFlags.TENSION in verdict:
        return f"{name}: the tension is at slave.gate.tension_max; lower slave.initialise.tension"
    if GateFlags.STALE in verdict:
        return f"{name}: its tension is older than slave.gate.tension_age_max; check the load cell"
    limit = "displacement_min" if request < 0.0 else "displacement_max"
    if seeking:
        return (
            f"{name}: no stop found before slave.gate.{limit}: check that it exists, or widen the "
            "limit"
        )
    return f"{name}: its motor is at slave.gate.{limit}: widen the limit"


def format_weak_motor(name: str, behind: float, tension: float, config: InitialiseConfig) -> str:
    """Message: a motor is `behind` [m] its command at a tension [N]."""
    return (
        f"{name}: the motor is {behind * 1e3:.1f} mm behind its command at {tension:.1f} N; check "
        f"that it can pull {config.tension:g} N, or lower slave.initialise.tension"
    )


def format_slack(
    name: str, wound: float, tension: float, taut: float, config: InitialiseConfig
) -> str:
    """Message: slack after winding in `wound` [m]; a tendon is taut from `taut` [N] on."""
    if tension > taut:
        return (
            f"{name}: {wound * 1e3:.1f} mm had to be wound in before it was taut, more than "
            f"slave.initialise.slack_max ({config.slack_max * 1e3:g} mm); shorten the tendon"
        )
    return (
        f"{name}: {tension:.2f} N after winding in {wound * 1e3:.1f} mm; the tendon is broken, "
        "too slack or not attached, or its load cell is stuck; check both"
    )


def format_no_loop(name: str, cause: str) -> str:
    """Message: the pulls and releases are not those of a tendon against its stop."""
    return (
        f"{name}: {cause}; check that the joint rests against its stop, that the tip does not "
        "press on something soft, and that the other tendon is not jammed"
    )


def format_unresolved_friction(
    name: str, K: float, peak: float, lowest: float, reach: float, is_full: bool
) -> str:
    """Message: K is at the end of the range that a loop between two tensions [N] resolves.

    `is_full` if more than one loop was pulled.
    """
    remedy = "" if is_full else ", or run the full procedure"
    return (
        f"{name}: K = {K:.2f} is at the limit of what a loop from {peak:.1f} N to {lowest:.2f} N "
        f"resolves ({reach:.2f}) and may be higher; check that the tendon is not jammed, raise "
        f"slave.initialise.tension, lower slave.initialise.low{remedy}"
    )


def format_residual_tension(name: str, paid_out: float, tension: float) -> str:
    """Message: a tension [N] remains after paying out `paid_out` [m]."""
    return (
        f"{name}: still {tension:.2f} N after paying out {paid_out * 1e3:.1f} mm; something pulls "
        "on the joint, or one of its load cells is stuck or not tared; check both"
    )


def format_no_stop(name: str, tension: float, unchanged: bool, config: InitialiseConfig) -> str:
    """Message: no stop found; `unchanged` if the reading never changed."""
    text = f"{name}: no stop within {config.travel_max * 1e3:g} mm, the tension is {tension:.2f} N"
    if unchanged:
        return f"{text}, and the reading never changes; check the load cell"
    return f"{text}; check that the tendon is attached, or raise slave.initialise.travel_max"


def format_late_stop(name: str, contact: float, tension: float) -> str:
    """Message: the joint moved freely up to `contact` [N], close to the target tension [N]."""
    return (
        f"{name}: {tension:.1f} N were reached before or just after the stop ({contact:.1f} N): "
        "the tip presses on something soft, or friction, spring and the other tendon take all "
        "the tension; free the tip, or raise slave.initialise.tension"
    )


def format_soft_stop(name: str, contact: float, compliance: float, softest: float) -> str:
    """Message: the stop yields; compliances in m/N."""
    return (
        f"{name}: beyond {contact:.1f} N it yields by {compliance * 1e3:.3f} mm/N, more than any "
        f"sheath of this rig ({softest * 1e3:.3f} mm/N): the tip presses on something soft; free "
        "it"
    )


def format_saturated_cell(name: str, tension: float) -> str:
    """Message: a load cell does not respond to the motor."""
    return (
        f"{name}: the load cell reads {tension:.2f} N without any change while the motor pulls: "
        "it is stuck or saturated; check its cable and amplifier, or lower "
        "slave.initialise.tension"
    )


def format_lost_tension(name: str, highest: float, tension: float) -> str:
    """Message: the tension was lost."""
    return (
        f"{name}: the tension was {highest:.1f} N and is {tension:.1f} N although the motor "
        "pulls: the tendon slipped or broke"
    )


def format_pull_not_repeated(name: str, tension: float, config: InitialiseConfig) -> str:
    """Message: the tension is not reached in a later pull."""
    return (
        f"{name}: the later pull reached only {tension:.1f} N, not {config.tension:g} N: the stop "
        "yields or the tendon slips; check both"
    )


def format_unreached_posture(joint: int, left: float, tension: float) -> str:
    """Message: a joint ends a move `left` [m] before its end, or beyond it if negative."""
    where = f"{left * 1e3:.1f} mm before" if left > 0.0 else f"{-left * 1e3:.1f} mm beyond"
    return (
        f"joint {joint}: posture not reached: {tension:.1f} N {where} its place; free the tip and "
        "the links, and check its stops and arms.radii"
    )


def format_obstacle(joint: int, tension: float) -> str:
    """Message: the tension on the way back is too high for a free joint."""
    return (
        f"joint {joint}: {tension:.1f} N on the way back from the stop, where the joint moved "
        "freely before: remove the obstacle"
    )
