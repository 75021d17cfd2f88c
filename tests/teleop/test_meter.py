"""When a loop reports, and what."""

from teleop.clock import Grid
from teleop.link import Counts
from teleop.meter import REPORT_PERIOD_NS, LoopMeter
from teleop.session import Session
from teleop.topics import Role

MS = 1_000_000


def reports(stamps):
    """The offsets [ns] of those ticks that report, counted from the start."""
    loop = LoopMeter(Role.SLAVE, Grid(1000, lambda: True))
    start = loop._due_ns - REPORT_PERIOD_NS
    return [t for t in stamps if loop.report(start + t, Session(), Counts()) is not None]


def test_a_loop_reports_once_a_period():
    assert reports(range(0, 2001 * MS, MS)) == [500 * MS, 1000 * MS, 1500 * MS, 2000 * MS]


def test_after_a_stall_there_is_one_report_and_then_one_a_period():
    stamps = [*range(0, 700 * MS, MS), *range(10_300 * MS, 11_600 * MS, MS)]
    assert reports(stamps) == [500 * MS, 10_300 * MS, 10_500 * MS, 11_000 * MS, 11_500 * MS]


def test_the_rate_is_that_of_the_span_reported():
    grid = Grid(1000, lambda: True)
    loop = LoopMeter(Role.MASTER, grid)
    start = loop._since_ns
    rates = []
    for seconds, ticks in ((1, 250), (2, 500)):
        grid.stats.ticks += ticks
        report = loop.report(start + seconds * 1000 * MS, Session(), Counts())
        rates.append(report.rate_hz)
    assert rates == [250.0, 500.0]
