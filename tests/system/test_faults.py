"""A few faults in one session, judged from its recording; see `campaign` for many."""

import os
import shutil

import numpy as np
import pytest

from studies.faults.campaign import failures, harm
from studies.faults.judge import FRESH_NS, CampaignResult, Ticks, judge, onsets, silences, unasked
from studies.faults.session import HELD, PERIOD, Fault, FaultSession

LIMIT_S = 0.050  # what a side has, counted from the last fresh message it heard
RATE = "rate_hz=250"  # five processes with a 1 kHz loop each are more than two slow cores carry
FEW = (("stop", "slave"), ("stop", "master"), ("cut", "both"))
MORE = (
    ("kill", "impair"),
    ("unplug", "master"),
    ("descriptors", "slave"),
    ("descriptors", "master"),
    *([("wall", "slave"), ("wall", "master")] if shutil.which("cc") else []),
    *([("oom", "record"), ("oom", "master")] if os.geteuid() == 0 else []),
)
MS = 1_000_000


@pytest.mark.parametrize("plan", [FEW, pytest.param(FEW + MORE, marks=pytest.mark.slow)])
def test_faults_are_taken_in_time_and_nothing_moves_again_unasked(tmp_path, demo_config, plan):
    with FaultSession(tmp_path, demo_config, RATE) as bench:
        faults = harm(bench, plan, np.random.default_rng(1))
        bench.end()
    verdict = judge(bench.recordings(), faults)
    sides = {(fault.name, side) for fault, side, _ in verdict.reactions}
    assert {("stop slave", "master"), ("stop master", "slave"), ("cut both", "slave")} <= sides
    assert max(seconds for _, _, seconds in verdict.reactions) <= LIMIT_S
    assert max(verdict.worst.values()) <= LIMIT_S
    assert verdict.engagements >= 3
    assert verdict.engaged_unasked == 0
    assert verdict.followed_nobody == 0
    assert verdict.pulled_in == 0.0
    assert verdict.let_out == 0.0
    assert verdict.broken_off == []


def test_a_campaign_in_which_nothing_was_seen_has_failed():
    faults = [Fault("cut", "both", 0.2, 0, MS)] * 4
    nothing = CampaignResult([], {"master": 0.0, "slave": 0.0}, {}, 0, 0, 0.0, 0.0, 0, [], 0.001)
    assert len(failures(nothing, faults)) == 2
    seen = [(fault, side, 0.028) for fault in faults for side in ("master", "slave")]
    assert failures(nothing._replace(reactions=seen, engagements=4), faults) == []
    late = nothing._replace(reactions=seen, engagements=4, worst={"master": 0.2, "slave": 0.0})
    assert failures(late, faults) == ["a side acted in a long silence"]


# --- the judge itself -----------------------------------------------------------------------------


def heard(echoes_ms):
    """One tick a millisecond, and the echo [ms] in each; every message took 1 ms."""
    rows = np.zeros(len(echoes_ms), [("stamp_ns", "i8"), ("echo_stamp_ns", "i8")])
    rows["stamp_ns"] = np.arange(len(echoes_ms)) * MS
    rows["echo_stamp_ns"] = np.array(echoes_ms) * MS
    return rows


def silence_ms(echoes_ms):
    rows = heard(echoes_ms)
    peer = np.zeros(max(echoes_ms) + 1, [("stamp_ns", "i8")])
    peer["stamp_ns"] = np.arange(len(peer)) * MS
    return silences(rows, rows["stamp_ns"], peer, peer["stamp_ns"], FRESH_NS) // MS


def test_silence_counts_from_the_last_message_that_was_heard_for_the_first_time():
    assert list(silence_ms([0, 1, 2, 3, 3, 3, 3, 7, 8])[1:]) == [0, 0, 0, 1, 2, 3, 0, 0]


def test_an_old_message_does_not_end_a_silence():
    begin = list(range(10))
    assert silence_ms([*begin, *[9] * 50, 12])[-1] == 51  # sent at 12 ms, heard at 60
    assert silence_ms([*begin, *[9] * 50, 58])[-1] == 0


def session(engaged_s, seconds=20.0):
    """A master's ticks, 1 every 10 ms, engaged in the given spans [s] after its start."""
    times = np.arange(0, seconds, 0.01)
    state = np.ones(len(times), int)
    for begin, end in engaged_s:
        state[(times >= begin) & (times < end)] = 2
    stamps = (times * 1e9).astype("i8")
    nothing = np.zeros(len(times), int)
    sequence = np.arange(len(times))
    return Ticks(nothing, sequence, stamps, nothing, stamps, state, nothing, state == 2, 10 * MS)


def count_unasked(*engaged_s):
    master = session(engaged_s)
    return unasked(master, onsets(master))


def test_an_engagement_needs_a_press_of_its_own():
    press, end = HELD
    assert count_unasked((press, end), (PERIOD + press + 0.5, PERIOD + end)) == 0
    assert count_unasked((press, 1.0), (1.5, end)) == 1  # again, in the same press
    assert count_unasked((end + 0.1, end + 0.15)) == 1  # while the switch was open
