"""`teleop run`: the whole session, its summary, its recording, and how it ends."""

import json
import re
import signal
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from studies.testbed.processes import (
    OURS,
    START_S,
    Processes,
    find_free_ports,
    has_ended_well,
    pause,
    wait_for_condition,
)
from teleop.messages.topics import HAND, TENDONS
from teleop.recording.reader import read_columns
from teleop.session.state_machine import State
from tests.root import ROOT

_started: list[subprocess.Popen[str]] = []


@pytest.fixture(autouse=True)
def nothing_left():
    """End what a failed test has started: it would take the processor from all later ones."""
    yield
    while _started:
        process = _started.pop()
        if process.poll() is None:
            process.terminate()
            process.communicate(timeout=30)


def run(config, folder, *arguments, wait=True, environment=OURS):
    master, slave = find_free_ports(2)
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "teleop", "run", "--config", str(config)),
            *("--set", f"link.master=127.0.0.1:{master}"),
            *("--set", f"link.slave=127.0.0.1:{slave}"),
            *("--json", str(folder / "run.json"), *arguments),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        env=environment,
    )
    _started.append(process)
    if not wait:
        return process
    out, err = process.communicate(timeout=START_S)
    return process.returncode, out, err


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A recorded session, what was refused beside it, and how it ended by Ctrl-C."""
    folder = tmp_path_factory.mktemp("recorded")
    json_file = str(folder / "run.json")
    with Processes(folder, ROOT / "configs" / "demo.yaml", "rate_hz=250") as session:
        words = ("--view", "none", "--record", str(folder), "--json", json_file)
        started = session.start("run", *words)
        with session.look() as link:
            assert wait_for_condition(lambda: session.engaged(link), START_S), session.outputs()
        (port,) = find_free_ports(1)
        master = session.start("master", "--set", f"link.master=127.0.0.1:{port}")
        second = session.start("run", "--view", "none", "--record", str(folder / "second"))
        refused = master.wait(30), second.wait(30)
        pause(1.0)
        children = children_of(started.pid)
        started.send_signal(signal.SIGINT)
        code = started.wait(30)
    left = [child for child in children if "teleop" in command_of(child)]
    return SimpleNamespace(folder=folder, code=code, refused=refused, left=left)


def test_a_recorded_run_tells_everything_and_ctrl_c_ends_it_cleanly(recorded):
    folder, out = recorded.folder, (recorded.folder / "0-run.log").read_text()
    assert has_ended_well(recorded.code, out), out
    assert recorded.left == []
    assert "command to force" in out
    summary = json.loads((folder / "run.json").read_text())
    for role in ("master", "slave"):
        assert summary[role]["ticks"] > 500
        assert summary[role]["final_state"] in {"engaged", "ready"}
    assert summary["master"]["latency_ms"]["n"] > 200
    assert 0 < summary["master"]["latency_ms"]["p50"] <= summary["master"]["latency_ms"]["p99"]
    force = summary["slave"]["force_error"]
    assert force["full_scale_N"] > 3.0  # the tip met something
    assert force["mean_percent"] < 2.0

    (recording,) = folder.glob("*.mcap")
    tendons = read_columns(recording, TENDONS.name)
    error = tendons["distal_tension"][:, 0] - tendons["bench_distal_tension"][:, 0]
    assert np.sqrt(np.mean(error**2)) == pytest.approx(force["rmse_N"], rel=0.1)
    hand = read_columns(recording, HAND.name)
    assert np.abs(hand["force"][:, 0]).max() > 0.3
    assert (hand["state"] == State.ENGAGED).sum() > 300


def test_a_second_master_and_a_second_run_of_the_name_are_refused_in_a_line(recorded):
    assert recorded.refused == (2, 2)
    for name in ("1-master", "2-run"):
        (line,) = (recorded.folder / f"{name}.log").read_text().splitlines()
        assert re.search("has a (master|slave) already", line)
    assert not (recorded.folder / "second").exists()


@pytest.mark.parametrize(
    "delay_s", [0.5, *(pytest.param(delay, marks=pytest.mark.slow) for delay in (0.2, 1.0))]
)
def test_an_early_ctrl_c_is_quiet(demo_config, tmp_path, delay_s):
    process = run(demo_config, tmp_path, "--view", "none", wait=False)
    pause(delay_s)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "Traceback" not in out + err
    assert "killed" not in out
    assert not children_of(process.pid)


def children_of(pid):
    out = subprocess.run(["ps", "-eo", "pid=,ppid="], capture_output=True, text=True, check=True)
    pairs = [tuple(map(int, line.split())) for line in out.stdout.splitlines()]
    return [child for child, parent in pairs if parent == pid]


def command_of(pid):
    out = subprocess.run(
        ["ps", "-o", "args=", "-p", str(pid)], capture_output=True, text=True, check=False
    )
    return out.stdout


@pytest.mark.slow
def test_a_slave_that_is_never_usable_is_told_why_and_exit_code_1(demo_config, tmp_path):
    calibration = tmp_path / "c.yaml"
    calibration.write_text("{rig: another, tendons: [{effective_friction: 0.8}]}\n")
    words = ("--duration", "1", "--view", "none", "--calibration", str(calibration))
    code, out, err = run(demo_config, tmp_path, *words)
    assert code == 1
    why = "c.yaml does not fit: it is for the rig 'another', this one is 'demo'"
    first, *repeated = [line for line in out.splitlines() if why in line]
    assert not first.endswith(" times)")
    assert len(repeated) <= 1
    assert all(line.endswith(" times)") for line in repeated)
    (line,) = err.splitlines()
    assert why in line
    summary = json.loads((tmp_path / "run.json").read_text())
    assert why in summary["reason"]
    assert summary["exit_code"] == 1


@pytest.mark.slow
def test_a_calibration_at_the_start_is_seen_and_interrupted_in_order(demo_config, tmp_path):
    words = ("slave.initialise.at_start=true", "slave.rig.joints.0.environment={type: free}")
    options = [word for text in words for word in ("--set", text)]
    process = run(demo_config, tmp_path, "--view", "none", *options, wait=False)
    line = ""
    while "seeking" not in line and "pulling" not in line:
        line = process.stdout.readline()
        assert line, process.communicate()
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "killed" not in out + err
    assert "Traceback" not in out + err
    assert not children_of(process.pid)
