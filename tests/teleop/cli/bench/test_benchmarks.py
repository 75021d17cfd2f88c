"""Measurements of the loops: figures, their comparison, and what is said of wrong words."""

import json
import os
import subprocess
import sys
import time

import pytest

from master.config import MasterConfig
from slave.config import SlaveConfig
from teleop.cli import commands
from teleop.cli.bench import figures, runs, session
from teleop.cli.bench.bare_grid import run_idle_loops
from teleop.cli.bench.figures import Metric
from teleop.config.loading import load
from teleop.runtime.realtime import RealtimeConfig


def test_a_ratio_is_the_median_of_each_run_by_its_own_baseline():
    busy = Metric("x", "us", (10.0, 40.0, 10.0), (5.0, 20.0, 5.0))  # the second run was held up
    assert busy.ratio == 2.0
    assert Metric("x", "", (1.0,), (0.0,)).ratio is None
    assert Metric("x", "", (1.0,)).ratio is None


def test_only_changes_beyond_the_spread_of_the_runs_count():
    old = Metric("x", "us", (10.0, 11.0, 12.0))
    assert figures.classify_change(old, old) == ""
    assert figures.classify_change(old._replace(values=(11.5, 12.5, 13.0)), old) == ""
    assert figures.classify_change(old._replace(values=(14.0, 14.5, 15.0)), old) == "WORSE"
    assert figures.classify_change(old._replace(values=(7.0, 7.5, 8.0)), old) == "better"
    rate = old._replace(higher_is_better=True)
    assert figures.classify_change(rate._replace(values=(7.0, 7.5, 8.0)), rate) == "WORSE"
    noisy = old._replace(values=(0.0, 14.5, 30.0))
    assert figures.classify_change(noisy, old) == ""


def test_a_figure_that_a_run_has_not_is_left_out_of_it():
    rows = [{"x": ("us", value, None, False), "y": ("us", None, 1.0, False)} for value in (1, None)]
    (found,) = figures.collect_metrics(rows)
    assert (found.name, found.values, found.baseline) == ("x", (1,), ())


def test_figures_survive_their_file():
    found = [Metric("x", "us", (1.0, 2.0), (0.5, 0.5)), Metric("r", "Hz", (9.0,), (), True)]
    read = figures.from_tree(json.loads(json.dumps(figures.to_tree(found))))
    assert list(read.values()) == found


def test_the_comparison_names_what_got_worse():
    old = Metric("x", "us", (1.0, 1.1))
    lines = figures.format_comparison([old._replace(values=(3.0, 3.1))], {"x": old})
    assert "WORSE" in lines[1]
    assert lines[-1].startswith("1 worse and 0 better")
    assert figures.format_comparison([old], {}) == ["no figures in common with the older result"]


@pytest.mark.parametrize("joints", [1, 2, 4, 8])
def test_configs_that_are_made_are_valid_and_have_so_many_joints(tmp_path, joints):
    path = runs.write_config(tmp_path / "c.yaml", joints)
    slave = load(path, SlaveConfig, "slave", ())
    master = load(path, MasterConfig, "master", ())
    assert [len(joint.tendons) for joint in slave.rig.joints] == [2] * joints
    assert master.device.axes == joints


def test_processor_time_is_that_of_the_process():
    program = "import time\nwhile True: time.process_time()"
    with subprocess.Popen([sys.executable, "-c", program]) as busy:
        try:
            processes = {"busy": busy.pid, "us": os.getpid()}
            before = session.sample_cpu_time(processes)
            time.sleep(0.5)
            shares = session.compute_cpu_load(processes, before, session.sample_cpu_time(processes))
        finally:
            busy.kill()
    assert 0.0 <= shares["us"] < shares["busy"] <= 110.0
    assert session.compute_cpu_load(
        processes, before, session.sample_cpu_time(processes)
    ).keys() == {"us"}


def test_a_session_is_measured_while_it_is_engaged(tmp_path):
    measured = session.run_session(runs.write_config(tmp_path / "session.yaml", 1), 1.5)
    assert measured.summary["master"]["ticks_in"]["engaged"] > 1000
    assert {"run", "slave", "master"} <= measured.cpu.keys()
    assert measured.cpu["slave"] > 0.0


def test_bare_loops_tick_at_their_rate_and_do_nothing():
    for loop in run_idle_loops(200.0, 0.5, RealtimeConfig(priority=0, cores=())):
        assert loop["work_us"]["n"] <= 102
        assert loop["work_us"]["n"] + loop["overruns"] >= 95
        assert loop["work_us"]["p50"] < 100.0


def test_facts_name_the_machine_and_the_versions():
    facts = runs.describe_machine()
    assert facts["packages"]["numpy"]
    assert len(facts["load_average"]) == 3
    assert json.loads(json.dumps(facts)) == facts


@pytest.mark.parametrize(
    "words",
    [
        ["loop", "--runs", "0"],
        ["loop", "--seconds", "1"],
        ["latency", "--joints", "9"],
        ["scale", "--joints", "0"],
        ["loop", "--config", "no-such-file.yaml"],
        ["loop", "--compare", "no-such-file.json"],
        ["loop", "--json", "."],
    ],
)
def test_wrong_words_get_one_line(words, capsys):
    assert commands.main(["bench", *words]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_result_of_another_bench_is_not_compared_with(tmp_path, capsys):
    for content in ({"bench": "scale", "figures": {}}, {"bench": "loop"}, [], {"x": 1}):
        path = tmp_path / "old.json"
        path.write_text(json.dumps(content))
        assert commands.main(["bench", "loop", "--compare", str(path)]) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1
