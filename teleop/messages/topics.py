"""The table of topics, for publisher, subscriber, recorder, viewer and docs.

Keys are `teleop/<session>/<topic>`. A live topic is best effort: an old value is dropped rather
than delivered late. Others are reliable.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Generic, TypeVar

from teleop.messages.messages import (
    Answer,
    Command,
    EmergencyStop,
    Event,
    Hand,
    Latency,
    Ledger,
    LinkReport,
    LoopReport,
    Message,
    Setting,
    Sheath,
    SlaveState,
    TendonState,
    TensionProfile,
)


class Role(IntEnum):
    """Role of a process in a session."""

    LAUNCHER = 0
    MASTER = 1
    SLAVE = 2
    RECORDER = 3
    VIEWER = 4
    REMOTE = 5  # `teleop stop`, `teleop set`
    WATCH = 6  # `teleop stop --watch`: its end is an emergency stop


def format_role(number: int) -> str:
    """Return the name of a role; its number if it is a newer one than ours."""
    try:
        return Role(number).name.lower()
    except ValueError:
        return f"role_{number}"


M = TypeVar("M", bound=Message)


@dataclass(frozen=True, slots=True)
class Topic(Generic[M]):
    """One line of the table."""

    name: str
    message: type[M]
    publisher: Role | None  # None = any
    rate_hz: float  # expected in normal operation; 0 = on events
    live: bool  # latest value counts: best effort, real-time priority, dropped when congested
    senders: tuple[Role, ...] = ()  # who may publish it, if there are several
    addressees: tuple[Role, ...] = ()  # who acts on it, and on nothing without a tag
    sampled_hz: float = 0.0  # of the copies of some messages for viewers, of each sender; 0 = none

    @property
    def publishers(self) -> tuple[Role, ...]:
        """The roles that may publish it."""
        return self.senders if self.publisher is None else (self.publisher,)


_SIDES = (Role.MASTER, Role.SLAVE)
_SUPERVISORS = (Role.LAUNCHER, Role.REMOTE, Role.WATCH)

COMMAND = Topic(
    "command", Command, Role.MASTER, 1000, live=True, addressees=(Role.SLAVE,), sampled_hz=50
)
STATE = Topic(
    "state", SlaveState, Role.SLAVE, 1000, live=True, addressees=(Role.MASTER,), sampled_hz=100
)
TENDONS = Topic("tendons", TendonState, Role.SLAVE, 1000, live=True, sampled_hz=100)
HAND = Topic("hand", Hand, Role.MASTER, 1000, live=True, sampled_hz=100)
PROFILE = Topic("profile", TensionProfile, Role.SLAVE, 50, live=True)
SHEATH = Topic("sheath", Sheath, Role.SLAVE, 1, live=False)
LEDGER = Topic("ledger", Ledger, None, 100, live=True, senders=_SIDES, sampled_hz=20)
EVENT = Topic("event", Event, None, 0, live=False, senders=_SIDES)
REPORT = Topic("report", LoopReport, None, 2, live=False, senders=_SIDES)
LATENCY = Topic("latency", Latency, Role.MASTER, 2, live=False)
STOP = Topic(
    "stop", EmergencyStop, None, 0, live=False,
    senders=_SIDES + _SUPERVISORS, addressees=_SIDES,
)  # fmt: skip
SETTING = Topic(  # of the sides only in a replay, without tags
    "setting", Setting, None, 0, live=False,
    senders=_SIDES + _SUPERVISORS, addressees=_SIDES,
)  # fmt: skip
ANSWER = Topic(
    "answer", Answer, None, 0, live=False, senders=_SIDES, addressees=_SUPERVISORS,
)  # fmt: skip
LINK = Topic("link", LinkReport, None, 2, live=False, senders=_SIDES)

TOPICS: tuple[Topic[Any], ...] = (
    COMMAND, STATE, TENDONS, HAND, PROFILE, SHEATH, LEDGER, EVENT, REPORT, LATENCY,
    STOP, SETTING, ANSWER, LINK,
)  # fmt: skip
