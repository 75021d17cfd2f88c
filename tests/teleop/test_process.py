"""What every command does around its work: arguments, summaries, and dying in time."""

import argparse
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from teleop.errors import TeleopError, UsageError
from teleop.runtime.process import (
    SUPERVISED_VARIABLE,
    StopCondition,
    defer_interrupt,
    die_with_launcher,
    die_with_parent,
    parse_seconds,
    write_summary,
)
from tests.one_side import without_traces
from tests.teleop.link.bench import wait_until


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "-1", "0", "1e400", "soon", ""])
def test_a_duration_is_a_number_above_0(text):
    with pytest.raises(argparse.ArgumentTypeError, match="above 0"):
        parse_seconds(text)


def test_a_duration_counts_from_the_first_tick_however_long_setting_up_took(monkeypatch):
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    stop = StopCondition(2.0)
    now[0] = 130.0
    assert not stop()
    now[0] = 131.9
    assert not stop()
    now[0] = 132.0
    assert stop()
    assert stop.reason == "duration reached"


LOST = """
import signal, sys, time
from teleop.__main__ import _install_interrupt_handler
class Deleted:
    def __del__(self):  # Python ignores what is raised here
        signal.raise_signal(signal.SIGINT)
_install_interrupt_handler()
try:
    Deleted()
    time.sleep(10)
except KeyboardInterrupt:
    print("interrupted")
"""


def test_an_interruption_that_python_ignores_is_delivered_again():
    run = subprocess.run(
        [sys.executable, "-c", LOST], capture_output=True, text=True, check=True, timeout=20
    )
    assert (run.stdout, run.stderr) == ("interrupted\n", "")


def test_an_interruption_comes_after_what_is_not_to_be_interrupted():
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    done = []

    def work():
        with defer_interrupt():
            signal.raise_signal(signal.SIGINT)
            done.append("all")

    try:
        with pytest.raises(KeyboardInterrupt):
            work()
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, handler)
    assert done == ["all"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_loop_is_stopped_by_each_signal_that_ends_a_command(number, monkeypatch):
    with without_traces(monkeypatch):
        stop = StopCondition()
        signal.raise_signal(number)
        assert (stop(), stop.reason) == (True, number.name)


def test_a_summary_that_cannot_be_written_is_one_line_and_leaves_nothing(tmp_path):
    (tmp_path / "taken").mkdir()
    for place in (tmp_path / "taken", tmp_path / "no" / "run.json"):
        with pytest.raises(UsageError, match="summary cannot be written"):
            write_summary(place, {"ticks": 1})
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


def test_who_was_started_by_a_process_that_has_ended_ends_too(monkeypatch):
    with pytest.raises(TeleopError, match="has ended"):
        die_with_parent(os.getpid())  # not our parent
    monkeypatch.setenv(SUPERVISED_VARIABLE, str(os.getpid()))
    with pytest.raises(TeleopError, match="has ended"):
        die_with_launcher()
    monkeypatch.delenv(SUPERVISED_VARIABLE)
    die_with_launcher()


CHILD = """
import os, sys, time
from teleop.runtime.process import die_with_launcher
print(os.getpid(), flush=True)
die_with_launcher()
time.sleep(60)
"""
PARENT = f"""
import os, subprocess, sys
os.environ["{SUPERVISED_VARIABLE}"] = str(os.getpid())
subprocess.Popen([sys.executable, "-c", sys.argv[1]]).wait()
"""


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux")
def test_a_child_dies_with_a_killed_parent():
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, CHILD], stdout=subprocess.PIPE, text=True
    )
    child = Path("/proc") / parent.stdout.readline().strip() / "stat"
    time.sleep(0.1)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    parent.stdout.close()
    wait_until(lambda: not child.exists() or " Z " in child.read_text())
