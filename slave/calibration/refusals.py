"""Why a calibration is given up: one line each, with the tendon, what was seen and a remedy."""

from slave.calibration.config import InitialiseConfig
from slave.gate import GateFlags

TENDON_NAMES = ("a", "b")


def tendon_name(joint: int, tendons: int, tendon: int) -> str:
    """Return how messages call a tendon: joints count from 1, tendons are a and b."""
    return f"joint {joint}, tendon {TENDON_NAMES[tendon]}" if tendons > 1 else f"joint {joint}"


def too_slow(joint: int, what: str, config: InitialiseConfig) -> str:
    """Return what is said of a phase that does not end."""
    return (
        f"joint {joint}: {what} took longer than {config.phase_max:g} s; look for what keeps it, "
        "or raise slave.initialise.phase_max"
    )


def withheld(name: str, verdict: GateFlags, asked: float, seeking: bool) -> str:
    """Return which limit of the gate lets a motor go no further; `asked` [m] says which way."""
    if GateFlags.TENSION in verdict:
        return (
            f"{name}: slave.gate.tension_max allows no further pull; lower slave.initialise.tension"
        )
    if GateFlags.STALE in verdict:
        return (
            f"{name}: its tension is older than slave.gate.tension_age_max; is the load cell alive?"
        )
    limit = "displacement_min" if asked < 0.0 else "displacement_max"
    if seeking:
        return (
            f"{name}: no stop found before slave.gate.{limit}: check that it exists, or widen the "
            "limit"
        )
    return f"{name}: its motor is at slave.gate.{limit}: widen the limit"


def weak_motor(name: str, behind: float, tension: float, config: InitialiseConfig) -> str:
    """Return what is said of a motor `behind` [m] its command, at a tension [N]."""
    return (
        f"{name}: the motor is {behind * 1e3:.1f} mm behind its command at {tension:.1f} N; is it "
        f"strong enough for {config.tension:g} N? Lower slave.initialise.tension"
    )


def slack(name: str, wound: float, tension: float, taut: float, config: InitialiseConfig) -> str:
    """Return what is said after winding in `wound` [m]; a tendon is taut from `taut` [N] on."""
    if tension > taut:
        return (
            f"{name}: {wound * 1e3:.1f} mm had to be wound in before it was taut, more than "
            f"slave.initialise.slack_max ({config.slack_max * 1e3:g} mm); shorten the tendon"
        )
    return (
        f"{name}: {tension:.2f} N after winding in {wound * 1e3:.1f} mm; the tendon is broken, far "
        "too slack or not attached, or its load cell is stuck"
    )


def no_loop(name: str, why: str) -> str:
    """Return what is said of pulls and releases that are none of a tendon against its stop."""
    return (
        f"{name}: {why}; does the joint rest against its stop? Its tip may press on something "
        "soft, or another tendon that is jammed in its sheath may have held it"
    )


def undecided(name: str, K: float, peak: float, lowest: float, reach: float, again: bool) -> str:
    """Return what is said of friction at the end of what a loop between two tensions [N] shows.

    `again`, if more than one loop was pulled.
    """
    more = "" if again else ", or do the full form"
    return (
        f"{name}: K = {K:.2f} is at the end of what a loop from {peak:.1f} N to {lowest:.2f} N "
        f"reaches ({reach:.2f}), and it may be more; is the tendon jammed in its sheath? "
        f"Else raise slave.initialise.tension, lower slave.initialise.low{more}"
    )


def tight(name: str, paid_out: float, tension: float) -> str:
    """Return what is said of a tension [N] that stays after paying out so much [m]."""
    return (
        f"{name}: still {tension:.2f} N after paying out {paid_out * 1e3:.1f} mm; something pulls "
        "on the joint, or a load cell of the joint is stuck or not tared"
    )


def no_stop(name: str, tension: float, unchanged: bool, config: InitialiseConfig) -> str:
    """Return what is said where no stop came; `unchanged`, if the reading never changed."""
    what = f"{name}: no stop within {config.travel_max * 1e3:g} mm, the tension is {tension:.2f} N"
    if unchanged:
        return f"{what}, and the reading never changes; is the load cell stuck?"
    return f"{what}; is the tendon attached? Else raise slave.initialise.travel_max"


def late_stop(name: str, contact: float, tension: float) -> str:
    """Return what is said where the joint moved up to `contact` [N], next to the end [N]."""
    return (
        f"{name}: {tension:.1f} N were reached while the joint still moved, or hardly after "
        f"({contact:.1f} N): the tip presses on something soft, or friction, spring and the other "
        "tendon take all the tension; free the tip, or raise slave.initialise.tension"
    )


def soft_stop(name: str, contact: float, compliance: float, softest: float) -> str:
    """Return what is said of a stop that gives way, compliances in m/N."""
    return (
        f"{name}: beyond {contact:.1f} N it gives way by {compliance * 1e3:.3f} mm/N, more than "
        f"any sheath here ({softest * 1e3:.3f} mm/N): the tip presses on something soft; free it"
    )


def saturated(name: str, tension: float) -> str:
    """Return what is said of a load cell that does not see the motor pull; it says not why."""
    return (
        f"{name}: the load cell reads {tension:.2f} N and not the least bit else while the motor "
        "pulls on: it is stuck, or saturated; look at its cable and amplifier, or lower "
        "slave.initialise.tension"
    )


def lost(name: str, highest: float, tension: float) -> str:
    """Return what is said of a tension that is gone."""
    return (
        f"{name}: the tension was {highest:.1f} N and is {tension:.1f} N although the motor pulls: "
        "the tendon has slipped or broken"
    )


def pull_not_repeated(name: str, tension: float, config: InitialiseConfig) -> str:
    """Return what is said where a tension is not reached for a second time."""
    return (
        f"{name}: pulled again it came to {tension:.1f} N only, not {config.tension:g} N: the stop "
        "gives way or the tendon slips; look at both"
    )


def in_the_way(joint: int, tension: float) -> str:
    """Return what is said of a tension that no joint takes that moves freely."""
    return (
        f"joint {joint}: {tension:.1f} N on the way back from the stop, where it moved freely "
        "before: something is in its way"
    )
