"""State of a session as the panel shows it: both sides' states as one, and the link's quality."""

from collections.abc import Mapping
from typing import NamedTuple

from teleop.messages.topics import Role, format_role
from teleop.session.state_machine import Reason, State
from teleop.session.summary import PEER_REASONS

# the first of these that a side is in is that of the session
_SEVERITY_ORDER = (
    State.STOPPED, State.FAULT, State.HOLDING, State.OFF, State.READY, State.CLUTCHED,
    State.ENGAGED,
)  # fmt: skip
_SERIOUS_STATES = {
    State.STOPPED,
    State.FAULT,
    State.HOLDING,
}  # shown even if the peer sends nothing
_REASONS = {int(reason): reason for reason in Reason}
NO_DATA = "no data"
NO_LINK = "none"
_POOR_LOSS, _BAD_LOSS = 0.01, 0.1  # shares of the peer's messages


class Banner(NamedTuple):
    """What the banner says."""

    state: str  # name of a state in small letters, or `NO_DATA`
    reason: str = ""


def build_banner(sides: Mapping[Role, tuple[int, int]]) -> Banner:
    """Return the state of the session from each side's state and reason.

    It is the most severe of the two, so it is engaged only if both are. Of two sides in that state
    the one whose reason is its own is quoted. Its peer has its name: who watches sees both sides.
    """
    states = {role: State(number) for role, (number, _) in sides.items()}
    serious = any(state in _SERIOUS_STATES for state in states.values())
    if set(sides) != {Role.MASTER, Role.SLAVE} and not serious:
        missing = [format_role(role) for role in (Role.MASTER, Role.SLAVE) if role not in sides]
        return Banner("off", f"waiting for the {' and the '.join(missing)}")
    worst = min(states.values(), key=_SEVERITY_ORDER.index)
    reasons = [
        (role, _REASONS.get(sides[role][1], Reason.UNKNOWN))
        for role, state in states.items()
        if state is worst
    ]
    own = [(role, reason) for role, reason in reasons if reason not in PEER_REASONS]
    role, reason = (own or reasons)[0]
    peer = format_role(Role.SLAVE if role is Role.MASTER else Role.MASTER)
    text = "" if reason is Reason.NONE else reason.text.replace("peer", peer)
    return Banner(worst.name.lower(), text)


class LinkCounts(NamedTuple):
    """Of one side, since its loop began."""

    received: int
    lost: int  # or rejected


class LinkQuality(NamedTuple):
    """Quality of the link over the last reports."""

    word: str  # good, poor, bad or `NO_LINK`
    loss: float  # share of the messages that did not arrive in order, the worse way
    latency_ms: float | None  # median, command to force; None if not known


def compute_link_quality(
    before: Mapping[Role, LinkCounts],
    now: Mapping[Role, LinkCounts],
    latency_ms: float | None,
    deaf: bool = False,
) -> LinkQuality:
    """Return the quality from two reports of each side; the worse way counts.

    With `deaf` a side has received nothing at all between its reports.
    """
    shares = [0.0]
    for role, counts in now.items():
        earlier = before.get(role, counts)
        lost, received = counts.lost - earlier.lost, counts.received - earlier.received
        if lost > 0:
            shares.append(lost / (lost + max(received, 0)))
    loss = max(shares)
    if deaf:
        return LinkQuality(NO_LINK, loss, None)
    word = "good" if loss < _POOR_LOSS else "poor" if loss < _BAD_LOSS else "bad"
    return LinkQuality(word, loss, latency_ms)
