"""Measurements of the loops: figures, their comparison, and what is said of wrong words."""

import json
import subprocess
from pathlib import Path

import pytest

from master.config import MasterConfig
from slave.config import SlaveConfig
from teleop.cli.bench import metric, repeated_runs, session
from teleop.cli.bench.metric import Metric
from teleop.config.loading import load


def test_a_ratio_is_the_median_of_each_run_by_its_own_baseline():
    busy = Metric("x", "us", (10.0, 40.0, 10.0), (5.0, 20.0, 5.0))  # the second run was held up
    assert busy.ratio == 2.0
    assert Metric("x", "", (1.0,), (0.0,)).ratio is None
    assert Metric("x", "", (1.0,)).ratio is None


def test_a_result_names_the_commit_that_was_measured():
    words = ["git", "-C", str(Path(repeated_runs.__file__).parent), "rev-parse", "HEAD"]
    known = subprocess.run(words, capture_output=True, text=True, check=False)
    if known.returncode:
        pytest.skip("not a repository")
    assert known.stdout.startswith(repeated_runs.describe_machine()["commit"].rstrip("+"))


def test_only_changes_beyond_the_spread_of_the_runs_count():
    old = Metric("x", "us", (10.0, 11.0, 12.0))
    assert metric.classify_change(old, old) == ""
    assert metric.classify_change(old._replace(values=(11.5, 12.5, 13.0)), old) == ""
    assert metric.classify_change(old._replace(values=(14.0, 14.5, 15.0)), old) == "WORSE"
    assert metric.classify_change(old._replace(values=(7.0, 7.5, 8.0)), old) == "better"
    rate = old._replace(higher_is_better=True)
    assert metric.classify_change(rate._replace(values=(7.0, 7.5, 8.0)), rate) == "WORSE"
    noisy = old._replace(values=(0.0, 14.5, 30.0))
    assert metric.classify_change(noisy, old) == ""


@pytest.mark.parametrize("joints", [1, 8])
def test_configs_that_are_made_are_valid_and_have_so_many_joints(tmp_path, joints):
    path = repeated_runs.write_config(tmp_path / "c.yaml", joints)
    slave = load(path, SlaveConfig, "slave", ())
    master = load(path, MasterConfig, "master", ())
    assert [len(joint.tendons) for joint in slave.rig.joints] == [2] * joints
    assert master.device.axes == joints


@pytest.mark.slow
@pytest.mark.real_time
def test_a_session_is_measured_while_it_is_engaged(tmp_path):
    measured = session.run_session(repeated_runs.write_config(tmp_path / "session.yaml", 1), 1.5)
    assert measured.summary["master"]["ticks_in"]["engaged"] > 1000
    assert {"run", "slave", "master"} <= measured.cpu.keys()
    assert measured.cpu["slave"] > 0.0


def test_a_result_of_another_bench_is_not_compared_with(tmp_path, refused):
    for content in ({"bench": "scale", "figures": {}}, {"bench": "loop"}, [], {"x": 1}):
        path = tmp_path / "old.json"
        path.write_text(json.dumps(content))
        refused("bench", "loop", "--compare", path)
