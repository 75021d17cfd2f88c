"""A few faults in one session, judged from its recording; see `campaign` for many."""

import os
import shutil

import numpy as np
import pytest

from studies.faults.campaign import inject_faults
from studies.faults.judge import judge_recordings
from studies.faults.session import FaultSession

LIMIT_S = 0.050  # what a side has, counted from the last fresh message it heard
RATE = "rate_hz=250"  # five processes with a 1 kHz loop each are more than two slow cores carry
FEW = (("kill", "slave"), ("stop", "master"), ("cut", "both"))
MORE = (
    ("stop", "slave"),
    ("kill", "impair"),
    ("unplug", "master"),
    ("descriptors", "slave"),
    ("descriptors", "master"),
    *([("wall", "slave"), ("wall", "master")] if shutil.which("cc") else []),
    *([("oom", "record"), ("oom", "master")] if os.geteuid() == 0 else []),
)


@pytest.mark.parametrize("plan", [FEW, pytest.param(FEW + MORE, marks=pytest.mark.slow)])
def test_faults_are_taken_in_time_and_nothing_moves_again_unasked(tmp_path, demo_config, plan):
    with FaultSession(tmp_path, demo_config, RATE) as bench:
        faults = inject_faults(bench, plan, np.random.default_rng(1))
        bench.end()
    verdict = judge_recordings(bench.recordings(), faults)
    sides = {(fault.name, side) for fault, side, _ in verdict.reactions}
    assert {("kill slave", "master"), ("stop master", "slave"), ("cut both", "slave")} <= sides
    assert max(seconds for _, _, seconds in verdict.reactions) <= LIMIT_S
    assert max(verdict.worst.values()) <= LIMIT_S
    assert verdict.engagements >= 3
    assert verdict.engaged_unasked == 0
    assert verdict.followed_nobody == 0
    assert verdict.pulled_in == 0.0
    assert verdict.let_out == 0.0
    assert verdict.broken_off == []
