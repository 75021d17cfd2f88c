"""`teleop pair`: what it reads, what it refuses in one line, and what it writes."""

import contextlib
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from estimator.pair.pair_study import SHARE
from teleop.cli import commands
from teleop.cli.pair import PairConfig, read_records
from teleop.config.loading import load
from teleop.data.mapping_file import TableMapping
from teleop.data.read_summary import format_read_summary
from teleop.errors import UsageError
from tests.estimator.pair import pair_bench as bench

CONFIG = Path(__file__).parents[3] / "configs" / "endoscope-pair.yaml"
COLUMNS = "time_s,command_angle_deg,distal_angle_deg,proximal_tension_a_N,proximal_tension_b_N"
BENDS = (0, 100, 200)


def write(path, record, head=COLUMNS):
    angles = np.degrees([record.command, record.angle])
    rows = np.column_stack([record.time, *angles, record.tension_a, record.tension_b])
    np.savetxt(path, rows, delimiter=",", header=head, comments="", fmt="%.9g")
    return str(path)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pair")
    return [
        write(folder / f"bend{bend}.csv", bench.record(math.radians(bend), samples=60))
        for bend in BENDS
    ]


@pytest.fixture(scope="module")
def done(files, tmp_path_factory):
    """Return the folder that the command has written, with one bend kept apart."""
    folder = tmp_path_factory.mktemp("out")
    further = write(folder / "bend150.csv", bench.record(math.radians(150.0), samples=60))
    out = folder / "report"
    words = ["pair", *files, "--columns", str(CONFIG), "--validate", further, "--out", str(out)]
    with (folder / "said.txt").open("w") as said, contextlib.redirect_stdout(said):
        assert commands.main([*words, "--json", str(folder / "numbers.json")]) == 0
    return out


def test_the_report_has_friction_and_its_growth(done):
    report = json.loads((done / "report.json").read_text())
    assert report["bends"] == pytest.approx([math.radians(bend) for bend in BENDS])
    assert report["growth"]["value"] == pytest.approx(bench.COEFFICIENT, rel=0.1)
    K = [number["value"] for number in report["friction"]]
    assert sorted(K) == K
    (kept,) = report["validation"]
    assert kept["ours"]["share"] < 0.05 < kept["baselines"][SHARE]["share"]
    assert json.loads((done.parent / "numbers.json").read_text()) == report
    read = [f"{each['file']}: {format_read_summary(each)}" for each in report["read_as"]]
    assert "bend150.csv: 60 samples, " in read[3]
    lines = (done.parent / "said.txt").read_text().splitlines()
    assert [line for line in lines if line in {f"read as: {each}" for each in read}] == [
        f"read as: {each}" for each in read
    ]
    assert all(f"<li>{line}</li>" in (done / "report.html").read_text() for line in read)


def test_files_are_read_in_the_order_of_their_bends_whatever_their_unit(tmp_path):
    rows = bench.record(1.5, samples=60)
    names = [tmp_path / "x_1.5_.csv", tmp_path / "x_0.5_.csv"]
    for path in names:
        np.savetxt(path, np.column_stack(rows[1:]), delimiter=",", header=COLUMNS, comments="")
    config = tmp_path / "columns.yaml"
    config.write_text("unit: rad\nbend: 'x_{bend}_'\nbends: [{file: x_0.5_.csv, bend: 0.25}]\n")
    found = [
        record for record, _ in read_records(names, load(config, PairConfig, None), TableMapping())
    ]
    assert [record.bend for record in found] == [0.25, 1.5]
    np.testing.assert_allclose(found[1].angle, rows.angle)


def test_a_mapping_tells_rate_decimals_and_run(tmp_path):
    rows = bench.record(1.5, samples=60)
    path, angles = tmp_path / "bend90.csv", np.degrees([rows.command, rows.angle])
    table = np.column_stack([np.arange(60), *angles, rows.tension_a, rows.tension_b])
    np.savetxt(path, table, "%.3f", ";", header=COLUMNS.replace(",", ";"), comments="")
    text = path.read_text().replace(".", ",")
    path.write_text(text + text)
    mapping = TableMapping(rate_hz=50.0, decimal="comma", run=2)
    ((found, _),) = read_records([path], PairConfig(), mapping)
    np.testing.assert_allclose(found.time, np.arange(60) / 50.0)
    np.testing.assert_allclose(found.tension_b, rows.tension_b, atol=1e-3)


def test_a_missing_column_is_named(files, tmp_path, refused):
    path = tmp_path / "bend10.csv"
    path.write_text("time_s,command_angle_deg\n0,0\n")
    assert "no column 'distal_angle_deg'" in refused("pair", *files, path)


def test_a_file_without_a_bend_is_named(files, tmp_path, refused):
    path = tmp_path / "run.csv"
    path.write_text(COLUMNS + "\n0,0,0,5,5\n")
    assert "does not tell the sheath's bend" in refused("pair", *files, path)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("0,0,0,5,5\n0,1,1,5,5\n", "time must increase"),
        ("0,0,0,5,5\n1,1,nan,5,5\n", "not finite"),
        ("0,0,0,5,5\n1,1,x,5,5\n", "'x' is not a number"),
        ("s,deg,deg,kgf,N\n0,0,0,5,5\n1,1,1,5,5\n", "says kgf, and N is read"),
        (f"0,0,0,5,5\n{COLUMNS}\n1,1,1,6,5\n", "has 2 runs, from line 2, line 4; one"),
    ],
)
def test_what_cannot_be_right_is_said(files, tmp_path, rows, message, refused):
    path = tmp_path / "bend10.csv"
    path.write_text(f"{COLUMNS}\n{rows}")
    line = refused("pair", *files, path)
    assert message in line
    assert str(path) in line


@pytest.mark.parametrize(
    ("changed", "unit", "message"),
    [
        (3, "deg", "'distal_angle_deg' never changes"),
        (4, "deg", "never changes (5)"),
        (None, "rad", "set unit: deg"),
    ],
)
def test_a_dead_sensor_and_degrees_are_named(tmp_path, changed, unit, message):
    time = 0.1 * np.arange(30.0)
    angles = (60.0 * np.sin(10.0 * time + k) for k in range(2))
    rows = np.column_stack([time, *angles, *[5.0 + time] * 2])
    if changed is not None:
        rows[:, changed - 1] = 5.0
    path, config = tmp_path / "bend10.csv", tmp_path / "columns.yaml"
    np.savetxt(path, rows, delimiter=",", header=COLUMNS, comments="")
    config.write_text(f"unit: {unit}\n")
    with pytest.raises(UsageError, match=re.escape(message)):
        read_records([path], load(config, PairConfig, None), TableMapping())
