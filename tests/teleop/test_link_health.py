"""Health of the link: figures against a simulated network, decisions with hysteresis, clocks."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.link import MessageCounts
from teleop.link.health import (
    SPAN_NS,
    Decision,
    HealthConfig,
    LinkCounts,
    LinkHealth,
    LinkMeasurement,
    LinkWindow,
    step,
    take_measurement,
    update_link_window,
)
from teleop.messages.messages import LinkReport
from teleop.messages.topics import Role
from teleop.session.state_machine import Reason

MS = 1_000_000
DT = SPAN_NS * 1e-9


def exchange(
    window, offset_ns, delays_in, delays_out, hold_ns=MS // 2, start_ns=10**15, tell_hold=True
):
    """Let a peer whose clock is `offset_ns` ahead answer every 10 ms; return the end."""
    now_ns = start_ns
    for delay_in, delay_out in zip(delays_in, delays_out, strict=True):
        answered_ns = now_ns + delay_out + hold_ns
        hold = hold_ns if tell_hold else 0
        update_link_window(window, answered_ns + offset_ns, answered_ns + delay_in, now_ns, hold)
        now_ns += 10 * MS
    return now_ns


delays = st.lists(st.integers(1, 20 * MS), min_size=3, max_size=40)


@given(delays, st.integers(-(10**17), 10**17), st.booleans(), st.randoms(use_true_random=False))
def test_the_true_offset_is_always_within_its_uncertainty(delays_in, offset_ns, tell_hold, chance):
    windows = LinkWindow.array()
    delays_out = [chance.randint(1, 20 * MS) for _ in delays_in]
    exchange(windows, offset_ns, delays_in, delays_out, tell_hold=tell_hold)
    figures = take_measurement(windows, LinkCounts(), LinkCounts())
    assert not figures.clock_set
    assert figures.offset_ns is not None
    assert abs(figures.offset_ns - offset_ns) <= figures.uncertainty_ns + 1
    trips = [a + b for a, b in zip(delays_in, delays_out, strict=True)]
    held = 0 if tell_hold else MS // 2
    assert figures.round_trip_ns == pytest.approx(sum(trips) / len(trips) + held, abs=2)
    assert figures.uncertainty_ns <= (min(trips) + held) // 2 + MS


def test_a_symmetric_link_gives_the_delay_of_each_direction():
    windows = LinkWindow.array()
    exchange(windows, 7_000 * MS, [3 * MS] * 20, [3 * MS] * 20)
    figures = take_measurement(windows, LinkCounts(), LinkCounts())
    assert (figures.offset_ns, figures.jitter_ns) == (7_000 * MS, 0)
    assert (figures.delay_in_ns, figures.delay_out_ns) == (3 * MS, 3 * MS)


@pytest.mark.parametrize("jump_ns", [-3_600_000 * MS, -100 * MS, 100 * MS, 3_600_000 * MS])
def test_a_clock_that_is_set_is_noticed_and_the_new_offset_found(jump_ns):
    windows = LinkWindow.array()
    end_ns = exchange(windows, 0, [3 * MS] * 50, [3 * MS] * 50)
    exchange(windows, jump_ns, [3 * MS] * 50, [3 * MS] * 50, start_ns=end_ns)
    figures = take_measurement(windows, LinkCounts(), LinkCounts())
    assert figures.clock_set
    assert figures.offset_ns == pytest.approx(jump_ns, abs=figures.uncertainty_ns + MS)


def test_a_clock_that_drifts_as_far_as_allowed_is_not_one_that_was_set():
    windows, start_ns = LinkWindow.array(), 10**15
    for k in range(1000):
        now_ns = start_ns + 10 * MS * k
        offset_ns = 10 * MS * k // 1000  # 1 ms a second
        update_link_window(windows, now_ns + MS + offset_ns, now_ns + 2 * MS, now_ns, 0)
    assert not take_measurement(windows, LinkCounts(), LinkCounts()).clock_set


@given(st.integers(0, 50), st.integers(0, 50), st.integers(0, 5))
def test_loss_counts_what_is_missing_but_not_what_was_overtaken(received, lost, late):
    before = LinkCounts(received=7, lost=3, out_of_order=1, repeated=2)
    now = LinkCounts(7 + received, 3 + lost + late, repeated=6, out_of_order=1 + late)
    figures = take_measurement(LinkWindow.array(), before, now)
    assert figures.loss == (lost / (lost + received) if lost + received else None)
    assert (figures.repeated, figures.out_of_order) == (4, late)


BOUNDS = HealthConfig(round_trip=0.1, hold_after=1.0, recover_after=0.5, scale_min=0.2)
BAD, NEAR, FINE = (LinkMeasurement(round_trip_ns=ms * MS) for ms in (101, 90, 10))


def run(decision, figures, seconds):
    out = [decision]
    for _ in range(round(seconds / DT)):
        out.append(step(BOUNDS, out[-1], figures, DT))
    return out[1:]


def test_beyond_a_bound_it_is_scaled_down_then_held_and_comes_back_with_hysteresis():
    down = run(Decision(), BAD, 1.0)
    scales = [decision.scale for decision in down]
    assert scales == sorted(scales, reverse=True)
    assert 0.9 < scales[0] < 1.0
    assert scales[-1] == pytest.approx(0.2)
    assert [decision.holds for decision in down] == [False] * 9 + [True]
    assert {decision.reason for decision in down} == {Reason.LINK_SLOW}

    near = run(down[-1], NEAR, 5.0)  # below the bound, but not by enough
    assert near[-1].holds
    assert near[-1].reason is Reason.LINK_SLOW
    short = run(near[-1], FINE, 0.4)
    assert short[-1].holds
    again = run(step(BOUNDS, short[-1], BAD, DT), FINE, 0.4)
    assert again[-1].holds  # the time below the bound began anew
    back = run(near[-1], FINE, 3.0)
    assert not back[4].holds
    scales = [decision.scale for decision in back]
    assert scales == sorted(scales)
    assert back[-1] == Decision()


def test_what_the_peer_finds_counts_as_what_we_find():
    decision = step(BOUNDS, Decision(), FINE, DT, peer=Reason.LINK_LOSS)
    assert (decision.reason, decision.scale < 1.0) == (Reason.LINK_LOSS, True)
    assert step(BOUNDS, Decision(), FINE, DT, peer=Reason.PEER_FAULT) == Decision()


@given(st.integers(100 * MS, 400 * MS), st.floats(0.0, 0.35), st.randoms(use_true_random=False))
def test_by_default_a_slow_lossy_link_changes_nothing(delay_ns, loss, chance):
    """Both ways 300 ms +- 50 ms, and a third lost, worked before there were bounds."""
    windows = LinkWindow.array()
    jitter = [chance.randint(-50 * MS, 50 * MS) for _ in range(40)]
    exchange(windows, 0, [delay_ns + j for j in jitter], [delay_ns] * 40)
    now = LinkCounts(received=1000 - round(1000 * loss), lost=round(1000 * loss))
    figures = take_measurement(windows, LinkCounts(), now)
    assert step(HealthConfig(), Decision(), figures, DT) == Decision()


def test_the_message_and_the_summary_have_the_figures():
    health = LinkHealth(BOUNDS)
    assert health.build_message(Role.SLAVE, MessageCounts(), 0).round_trip_ns == -1
    end_ns = exchange(health.windows, 5 * MS, [60 * MS] * 20, [60 * MS] * 20)
    assert health.is_due(end_ns)
    health.update(end_ns, MessageCounts(received=20, repeated=3))
    assert not health.is_due(end_ns + SPAN_NS - 1)
    exchange(health.windows, 5 * MS, [60 * MS] * 20, [60 * MS] * 20, start_ns=end_ns)
    assert health.update(end_ns + SPAN_NS, MessageCounts(received=40, repeated=3))
    message = LinkReport.unpack(
        health.build_message(Role.SLAVE, MessageCounts(repeated=3), 7).pack(1, 1, 1)
    )
    assert (message.round_trip_ns, message.offset_ns) == (120 * MS, 5 * MS)
    assert (message.reason, message.repeated, message.age_ns) == (Reason.LINK_SLOW, 3, 7)
    assert health.build_summary(MessageCounts()).scaled_s == pytest.approx(DT)
