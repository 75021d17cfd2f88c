"""When a loop reports, and what."""

import pytest

from teleop.link import MessageCounts
from teleop.link.health import HealthConfig, LinkHealth
from teleop.messages.topics import Role
from teleop.runtime.clock import TickStats
from teleop.session.loop_meter import REPORT_PERIOD_NS, LoopMeter
from teleop.session.state_machine import Reason, SessionOutline, State

MS = 1_000_000
NO_LINK = LinkHealth(HealthConfig()).build_summary(MessageCounts())


def reports(stamps):
    """The offsets [ns] of those ticks that report, counted from the start."""
    loop = LoopMeter(Role.SLAVE, TickStats())
    start = loop._due_ns - REPORT_PERIOD_NS
    return [t for t in stamps if loop.is_due(start + t)]


def test_after_a_stall_there_is_one_report_and_then_one_a_period():
    stamps = [*range(0, 700 * MS, MS), *range(10_300 * MS, 11_600 * MS, MS)]
    assert reports(stamps) == [500 * MS, 10_300 * MS, 10_500 * MS, 11_000 * MS, 11_500 * MS]


def test_the_rate_is_that_of_the_span_reported():
    stats = TickStats()
    loop = LoopMeter(Role.MASTER, stats)
    start = loop._since_ns
    rates = []
    for seconds, ticks in ((1, 250), (2, 500)):
        stats.ticks += ticks
        report = loop.build_report(start + seconds * 1000 * MS, SessionOutline(), MessageCounts())
        rates.append(report.rate_hz)
    assert rates == [250.0, 500.0]


ENGAGED = SessionOutline(State.ENGAGED, Reason.NONE)
READY = SessionOutline(State.READY, Reason.RELEASED)
BROKEN = SessionOutline(State.FAULT, Reason.TENDON_BROKEN)
WHERE = "joint 2, tendon b"


@pytest.mark.parametrize(
    ("sides", "ended"),
    [
        ([ENGAGED, READY], False),
        ([READY, BROKEN], True),  # it stands
        ([ENGAGED, BROKEN, BROKEN, READY], True),  # let go of, and nobody went on
        ([ENGAGED, BROKEN, READY, BROKEN, READY], True),
        ([ENGAGED, BROKEN, READY, ENGAGED, READY], False),
        ([READY, BROKEN, READY], False),  # it took nothing away, and is over
    ],
)
def test_a_fault_ends_a_session_unless_somebody_engages_again(sides, ended):
    loop = LoopMeter(Role.SLAVE, TickStats())
    for side in sides:
        loop.add_tick(side, 0, WHERE if side is BROKEN else "")
    summary = loop.build_summary(sides[-1], MessageCounts(), {}, NO_LINK)
    fault = Reason.TENDON_BROKEN, WHERE
    assert summary.ended_in == (fault if ended else None)
    assert set(summary.faults) == ({fault} if BROKEN in sides else set())


def test_why_a_side_was_not_usable_is_remembered():
    loop = LoopMeter(Role.SLAVE, TickStats())
    loop.add_tick(SessionOutline(), 0, "no calibration fits")
    finished = SessionOutline(State.OFF, Reason.RIG_FINISHED)
    loop.add_tick(finished, 0)
    summary = loop.build_summary(finished, MessageCounts(), {}, NO_LINK)
    assert summary.not_usable == (Reason.NOT_USABLE, "no calibration fits")
    assert summary.reason == (Reason.RIG_FINISHED, "")
