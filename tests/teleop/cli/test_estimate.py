"""`teleop estimate`: fits, calibration files, and what it says to wrong words and wrong data."""

import json

import numpy as np
import pytest
import yaml

from slave.calibration.calibration_file import Calibration
from slave.simulation.environment import STIFFNESS_MAX
from teleop.cli import commands
from teleop.config.loading import load
from teleop.data.measured_table import Columns, read_table, write_table
from teleop.data.read_summary import format_read_summary

RIG = (
    "slave.rig.joints=[{{tendons: [{{sheath: {{sections: {sections}, friction: 0.15}}}}], "
    "body: {tip}, environment: {{type: free}}}}]"
)
EVEN = "[{length: 1.5, radius: 0.225}]"  # K = 1, EA = 9000 N
UNEVEN = "[{length: 0.2, radius: 0.05}, {length: 1.3, radius: 0.5}]"  # K = 0.99
SPRING = "{pretension: 0.0, spring: 2000}"
BLOCKED = f"{{pretension: 0.0, spring: {STIFFNESS_MAX:g}}}"


def simulate(path, sections, tip, profile="nested", speed="0.004"):
    words = ["simulate", "--out", str(path), "--profile", profile, "--duration", "12"]
    words += ["--rate", "200", "--speed", speed]
    assert commands.main([*words, "--set", RIG.format(sections=sections, tip=tip)]) == 0
    return path


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    return simulate(tmp_path_factory.mktemp("data") / "bench.csv", EVEN, SPRING)


def blocked(tmp_path, sections):
    path = tmp_path / "loop.csv"
    return simulate(path, sections, BLOCKED, "loop", "0.0004")


def summary_of(tmp_path, *words):
    out = tmp_path / "summary.json"
    assert commands.main(["estimate", *map(str, words), "--json", str(out), "--force"]) == 0
    return json.loads(out.read_text())


def test_a_fit_finds_the_rigs_own_numbers(bench, tmp_path):
    summary = summary_of(tmp_path, bench, "--fit", "--length", "1.5")
    parameters = summary["fit"]["parameters"]
    assert parameters["K"]["value"] == pytest.approx(1.0, rel=0.01)
    assert parameters["EA"]["value"] == pytest.approx(9000.0, rel=0.05)
    assert summary["fit"]["accept"]
    assert summary["force_error"]["rmse_percent"] < 1.0


def test_a_saved_fit_gives_the_same_estimates(bench, tmp_path, capsys):
    saved = tmp_path / "sheath.yaml"
    by_fit, by_file = tmp_path / "fit.csv", tmp_path / "file.csv"
    summary_of(tmp_path, bench, "--fit", "--save", saved, "--out", by_fit)
    summary = summary_of(tmp_path, bench, "--calibration", saved, "--out", by_file)
    read_as = format_read_summary(summary["read_as"])
    assert read_as.startswith(f"{summary['samples']} samples, ")
    assert f"read as   {read_as}" in capsys.readouterr().out
    assert yaml.safe_load(saved.read_text())["source"] == f"bench.csv: {read_as}"
    assert by_fit.read_bytes() == by_file.read_bytes()
    table = read_table(by_fit)
    assert (table.extra["distal_tension_low_N"] <= table.extra["distal_tension_high_N"]).all()


def test_a_blocked_loop_calibrates_without_a_distal_sensor(tmp_path):
    summary = summary_of(
        tmp_path, blocked(tmp_path, EVEN), "--fit", "--blocked-tip", "--length", 1.5
    )
    parameters = summary["fit"]["parameters"]
    assert parameters["K"]["value"] == pytest.approx(1.0, rel=0.03)
    assert parameters["EA"]["value"] == pytest.approx(9000.0, rel=0.05)
    assert "agree" in summary["fit"]["reason"]


@pytest.mark.slow
def test_uneven_bends_are_told_from_the_loop(tmp_path):
    summary = summary_of(tmp_path, blocked(tmp_path, UNEVEN), "--fit", "--blocked-tip")
    parameters = summary["fit"]["parameters"]
    assert not summary["fit"]["accept"]
    assert "disagree" in summary["fit"]["reason"]
    assert parameters["K"]["value"] == pytest.approx(0.99, rel=0.12)
    assert parameters["K by slopes"]["value"] > 1.2  # what the paper's way would say


def test_what_is_not_accepted_is_saved_as_such(bench, tmp_path):
    table = read_table(bench)
    columns = table.columns()
    columns["distal_tension_N"] = 0.8 * table.distal_tension + 0.8 * np.sin(table.time)
    wrong, saved = tmp_path / "wrong.csv", tmp_path / "sheath.yaml"
    write_table(wrong, columns)
    summary = summary_of(tmp_path, wrong, "--fit", "--save", saved)
    assert not summary["fit"]["accept"]
    calibration = load(saved, Calibration, None)
    assert not calibration.accepted
    assert calibration.remark == summary["fit"]["reason"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "no model of the sheath"),
        (["--fit", "--calibration", "x.yaml"], "no model of the sheath"),
        (["--save", "x.yaml", "--calibration", "y.yaml"], "--fit"),
        (["--fit", "--length", "nan"], "--length"),
        (["--fit", "--length", "1e300"], "--length"),
        (["--fit", "--save", "no/such/folder/x.yaml"], "--save"),
        (["--fit", "--json", "."], "--json"),
        (["--calibration", "no-such.yaml"], "no-such.yaml"),
    ],
)
def test_wrong_words_are_one_line(bench, words, said, refused):
    assert said in refused("estimate", bench, *words)


def test_a_free_tip_is_not_taken_for_a_blocked_one(bench, tmp_path, refused):
    saved = tmp_path / "sheath.yaml"
    loop = simulate(tmp_path / "free.csv", EVEN, SPRING, "loop")
    assert "tip" in refused("estimate", loop, "--fit", "--blocked-tip", "--save", saved)
    assert not saved.exists()


def test_a_record_that_decides_nothing_is_refused(tmp_path, refused):
    path = tmp_path / "still.csv"
    time = np.arange(500) * 0.01
    tension = 5.0 + 0.2 * np.sin(time)
    write_table(
        path, {"time_s": time, "proximal_tension_N": tension, "distal_tension_N": 0.4 * tension}
    )
    saved = tmp_path / "sheath.yaml"
    assert "swing" in refused("estimate", path, "--fit", "--save", saved)
    assert not saved.exists()


def test_a_calibration_file_of_another_kind_is_refused(bench, tmp_path, refused):
    path = tmp_path / "wrong.yaml"
    path.write_text(yaml.safe_dump({"tendons": [{"effective_friction": -1.0}]}))
    assert "sheath K" in refused("estimate", bench, "--calibration", path)


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Return the config of a joint of two tendons that differ, and data of it."""
    folder = tmp_path_factory.mktemp("pair")
    config, data = folder / "pair.yaml", folder / "pair.csv"
    sheath = "{{sheath: {{sections: [{{length: 1.5, radius: {}}}]}}}}"
    config.write_text(
        f"slave: {{calibration: as-built, rig: {{type: simulated, joints: [{{tendons: "
        f"[{sheath.format(0.225)}, {sheath.format(0.45)}], environment: {{type: free}}}}]}}}}"
    )
    assert commands.main(["simulate", str(config), "--out", str(data), "--duration", "8"]) == 0
    return config, data


@pytest.mark.parametrize(
    ("words", "tendon", "bend"), [([], "1a", 0.225), (["--tendon", "1b"], "1b", 0.45)]
)
def test_of_several_tendons_one_is_estimated_and_named(pair, words, tendon, bend, tmp_path, capsys):
    config, data = pair
    summary = summary_of(tmp_path, data, "--config", config, *words)
    assert summary["tendon"] == tendon
    assert summary["model"]["sections"][0]["radius"] == bend
    assert f"tendon    {tendon}" in capsys.readouterr().out
    error = summary["force_error"]
    assert error["rmse_N"] < 0.1  # data and model are of the same one
    measured = read_table(data, Columns.from_tendon(1 + (tendon == "1b"))).distal_tension
    assert error["full_scale_N"] == measured.max()


def test_a_tendon_that_is_not_there_is_one_line(pair, refused):
    config, data = pair
    said = refused("estimate", data, "--config", config, "--tendon", "2a")
    assert "1a, 1b, 1, 2" in said
