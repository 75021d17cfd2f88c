"""Scheduling of the control processes: limits, cores, locked memory, and what they import."""

import json
import os
import resource
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.cli import commands
from teleop.config.loading import load
from teleop.errors import UsageError
from teleop.runtime import realtime
from teleop.runtime.realtime import (
    CORES_MIN,
    HARD_LIMIT_US,
    OTHER_CORES_MIN,
    SOFT_LIMIT_US,
    compute_rttime_limits,
    divide_cores,
    find_unmodified_code,
)
from teleop.session.config import RunConfig

CORES = st.sets(st.integers(0, 63), max_size=16)
LIMIT = st.one_of(st.just(resource.RLIM_INFINITY), st.integers(0, 10_000_000))


@given(CORES, st.one_of(st.just("auto"), st.lists(st.integers(0, 63), max_size=8)))
def test_loops_and_other_threads_share_no_core_and_use_only_allowed_ones(allowed, wanted):
    loops, others = divide_cores(allowed, wanted)
    assert len(loops) == len(set(loops))
    assert not others & set(loops)
    assert bool(loops) == bool(others)
    if loops:
        assert others | set(loops) == allowed
        assert len(others) >= OTHER_CORES_MIN
        assert wanted == "auto" or set(loops) <= set(wanted)


@given(st.sets(st.integers(0, 63), max_size=CORES_MIN - 1), st.booleans())
def test_with_few_cores_no_loop_has_one_of_its_own(allowed, auto):
    assert divide_cores(allowed, "auto" if auto else sorted(allowed)[:1]) == ([], set())


def test_both_loops_of_a_machine_of_four_cores_get_one():
    assert divide_cores(range(4), "auto") == ([3, 2], {0, 1})
    assert divide_cores(range(4), (1,)) == ([1], {0, 2, 3})
    assert divide_cores(range(4), ()) == ([], set())
    assert divide_cores(range(4), (1, 2, 3)) == ([], set())


def test_each_loop_gets_a_core_that_no_other_thread_or_loop_has(monkeypatch):
    free = f"{os.getpid()}-"  # not the names of a session that runs on this machine
    monkeypatch.setattr(realtime, "CORE_LOCK_NAME", free + "{core}")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(4)))
    moved = {}
    monkeypatch.setattr(os, "sched_setaffinity", moved.__setitem__)
    granted = []
    for core in (3, 2):
        realtime.pin_loop(granted)
        assert moved[0] == {core}
        assert all(cores == {0, 1} for thread, cores in moved.items() if thread)
        assert len(moved) > 1
    moved.clear()
    realtime.pin_loop(granted)  # none is left
    assert granted == ["core 3 for the loop", "core 2 for the loop"]
    assert not moved


@given(LIMIT, LIMIT)
def test_limits_are_never_raised_and_the_soft_one_comes_first(soft, hard):
    new_soft, new_hard = compute_rttime_limits(soft, hard)
    assert 0 <= new_soft <= min(SOFT_LIMIT_US, new_hard)
    assert new_hard <= HARD_LIMIT_US
    assert soft == resource.RLIM_INFINITY or new_soft <= soft
    assert hard == resource.RLIM_INFINITY or new_hard <= hard


SMAPS = """\
7f0000000000-7f0000100000 r--p 00000000 fe:00 1    /lib/libllvmlite.so
Anonymous:             0 kB
7f0000100000-7f0005100000 r-xp 00100000 fe:00 1    /lib/libllvmlite.so
Rss:               51200 kB
Anonymous:             0 kB
7f0005100000-7f0005200000 r-xp 05100000 fe:00 1    /lib/libllvmlite.so
Anonymous:             4 kB
7f0006000000-7f0006100000 r-xp 00000000 fe:00 2    /lib/libc.so
Anonymous:             0 kB
7f0007000000-7f0007100000 rw-p 00000000 00:00 0
Anonymous:          1024 kB
"""


def test_only_code_that_is_as_in_the_file_is_given_back():
    assert find_unmodified_code(SMAPS, "libllvmlite") == [(0x7F0000100000, 0x5000000)]
    assert find_unmodified_code("", "libllvmlite") == []


@pytest.mark.parametrize("wrong", ["priority=50", "cores=[-1]", "cores=some"])
def test_what_cannot_be_scheduled_is_refused(wrong):
    with pytest.raises(UsageError, match="realtime"):
        load(None, RunConfig, None, [f"realtime.{wrong}"])


RUNAWAY = """
import json, os, time
from teleop.runtime import realtime

realtime.SOFT_LIMIT_US = 200_000
granted = realtime.request_realtime()
if os.sched_getscheduler(0) != os.SCHED_FIFO:
    raise SystemExit(77)
realtime.limit_computing_time(granted)
end = time.monotonic() + 1.0
while time.monotonic() < end:  # sleeps in every period: is left alone
    time.sleep(0.001)
kept = os.sched_getscheduler(0) == os.SCHED_FIFO
end = time.monotonic() + 20.0
while os.sched_getscheduler(0) == os.SCHED_FIFO and time.monotonic() < end:
    pass
print(json.dumps([kept, os.sched_getscheduler(0) == os.SCHED_OTHER, granted]))
"""


def run(code, *arguments):
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False
    )


@pytest.mark.skipif(sys.platform != "linux", reason="SCHED_FIFO is of Linux")
def test_a_loop_that_never_sleeps_loses_its_priority_and_says_so():
    ended = run(RUNAWAY)
    if ended.returncode == 77:
        pytest.skip("SCHED_FIFO is not permitted here")
    assert ended.returncode == 0, ended.stderr
    kept, ordinary, granted = json.loads(ended.stdout)
    assert kept
    assert ordinary
    assert granted[-1].startswith("SCHED_FIFO disabled")
    assert ended.stderr == f"WARNING: {granted[-1]}\n"


RESIDENT = """
import mmap
from teleop.runtime import realtime

def resident_MB():
    with open("/proc/self/statm") as statm:
        return int(statm.read().split()[1]) * mmap.PAGESIZE / 1e6

reserved = mmap.mmap(-1, 400 << 20)
before = resident_MB()
locked = "memory locked" in realtime.request_realtime(realtime.RealtimeConfig(priority=0))
later = mmap.mmap(-1, 400 << 20)
print(locked, resident_MB() - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="mlockall is not everywhere")
def test_locking_memory_does_not_make_what_is_only_reserved_resident():
    locked, grown = run(RESIDENT).stdout.split()
    if locked != "True":
        pytest.skip("memory cannot be locked here")
    assert float(grown) < 50.0


IMPORTED = """
import contextlib, importlib, sys

if sys.argv[1] == "--help":
    from teleop.cli import commands

    with contextlib.suppress(SystemExit), contextlib.redirect_stdout(None):
        commands.main(["--help"])
else:
    for name in sys.argv[1:]:
        importlib.import_module(name)
print(*sys.modules)
"""
HEAVY = {"matplotlib", "pyarrow", "pandas", "rerun", "mcap", "shtab"}
SCIPY = {"scipy.optimize", "scipy.ndimage", "scipy.special", "scipy.stats", "scipy.signal"}
# numba itself imports the name scipy, for its version, and scipy.linalg when it first compiles


@pytest.mark.parametrize(
    ("what", "absent"),
    [
        (["--help"], {"numpy", "numba", "scipy", "zenoh", "yaml", "email", *HEAVY}),
        (["slave.process", "master.process"], {"scipy.linalg", *SCIPY, *HEAVY}),
    ],
)
def test_a_process_imports_only_what_it_needs(what, absent):
    ended = run(IMPORTED, *what)
    assert ended.returncode == 0, ended.stderr
    modules = set(ended.stdout.split())
    assert "teleop" in modules
    assert not absent & modules


def test_numeric_libraries_compute_in_one_thread_unless_told_otherwise(monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "")  # is put back
    monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    monkeypatch.setenv("NUMBA_NUM_THREADS", "2")
    commands.main(["run", "--config", "none.yaml"])
    assert (os.environ["OPENBLAS_NUM_THREADS"], os.environ["NUMBA_NUM_THREADS"]) == ("1", "2")
