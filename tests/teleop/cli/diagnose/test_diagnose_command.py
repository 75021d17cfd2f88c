"""`teleop diagnose`: what it writes, to whom, and what it says to wrong words and wrong data."""

import json
import math
import re

import numpy as np
import pytest
from rerun.chunk import RrdReader

from studies import hidden_effects
from teleop.cli import commands
from teleop.data import model_file
from teleop.data.file_formats import read_columns
from teleop.data.measured_table import write_table
from teleop.data.read_summary import format_read_summary

FAULT = "distal_tension_gain"
KEYS = {
    *("verdict", "cause", "candidates", "ambiguous_with", "parameters", "baseline", "extended"),
    *("gain", "noise", "simple_models", "simple_gain", "model_warnings", "driver", "seconds"),
}
COMPARED = {"proximal_tension", "distal_tension", "distal_displacement"}


def columns(data):
    units = {"tension": "N", "displacement": "m"}
    return {f"{name}_{units[name.split('_')[1]]}": y for name, y in data.channels.items()}


def write(path, data, rows=slice(None)):
    write_table(path, {n: y[rows] for n, y in ({"time_s": data.time} | columns(data)).items()})
    return path


@pytest.fixture(scope="module")
def data():
    return hidden_effects.make(5, (FAULT,), bench="spring", duration=16.0, rate=50.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("diagnosis")


@pytest.fixture(scope="module")
def csv(data, folder):
    return write(folder / "bench.csv", data)


@pytest.fixture(scope="module")
def report(data, csv, folder):
    """The numbers of one diagnosis of two files with a third for validation."""
    second = write(folder / "second.parquet", data, slice(250, None))
    third = write(folder / "third.csv", data, slice(0, 500))
    words = ["diagnose", csv, second, "--validate", third, "--effects", f"{FAULT},creep"]
    words += ["--out", folder / "out", "--json", folder / "numbers.json"]
    words += ["--supplement", folder / "supplement", "--leave-one-file-out"]
    assert commands.main([*map(str, words)]) == 0
    return json.loads((folder / "numbers.json").read_text(), parse_constant=pytest.fail)


def test_the_report_has_its_keys(report, folder):
    assert set(report) >= KEYS
    assert json.loads((folder / "out" / "report.json").read_text()) == report


def test_the_cause_is_named_with_its_size(report, data):
    assert (report["verdict"], report["cause"]) == ("named", [FAULT])
    gain = report["parameters"][f"{FAULT}.gain"]
    assert gain["value"] == pytest.approx(data.truth[FAULT]["gain"], rel=0.1)
    assert gain["low"] < gain["value"] < gain["high"]
    assert report["parameters"]["L/EA"]["unit"] == "m/N"


def test_the_candidates_are_ranked(report):
    scores = [one["score"] for one in report["candidates"]]
    assert scores == sorted(scores, reverse=True)
    assert report["candidates"][0]["name"] == FAULT
    assert {one["name"] for one in report["candidates"]} == {FAULT, "creep"}
    assert set(report["candidates"][0]["held_out_rmse"]) == COMPARED


def test_errors_are_of_fitted_held_out_and_validation_data(report):
    for name in ("fit", "held_out", "validation"):
        assert set(report["baseline"][name]) == COMPARED
        for channel in COMPARED:
            before, after = (report[m][name][channel] for m in ("baseline", "extended"))
            assert after["rmse"] < before["rmse"]
            assert 0.0 < after["mean_percent"] < after["max_percent"] < 100.0


@pytest.mark.slow
def test_noise_that_is_known_is_taken(csv, folder):
    words = ["diagnose", csv, "--effects", "creep", "--noise", "distal_tension=0.3"]
    assert commands.main([*map(str, words), "--json", str(folder / "noise.json")]) == 0
    found = json.loads((folder / "noise.json").read_text())
    assert found["noise"]["distal_tension"] == pytest.approx(0.3, rel=0.05)


@pytest.mark.slow
def test_a_tip_cell_that_drops_out_changes_no_verdict(capsys, data, folder):
    lost = data.channels["distal_tension"].copy()
    lost[400:450] = np.nan
    file = folder / "lost.csv"
    write_table(file, {"time_s": data.time} | columns(data) | {"distal_tension_N": lost})
    words = ["diagnose", file, "--effects", FAULT, "--json", folder / "lost.json"]
    words += ["--supplement", folder / "lost"]
    assert commands.main([*map(str, words)]) == 0
    found = json.loads((folder / "lost.json").read_text())
    assert (found["verdict"], found["cause"]) == ("named", [FAULT])
    gain = found["parameters"][f"{FAULT}.gain"]
    assert gain["low"] < data.truth[FAULT]["gain"] < gain["high"]
    out = capsys.readouterr().out
    assert out.count("50 missing values, not compared (tension at the tip), the first at") == 1
    lines = (folder / "lost" / "residuals-1.csv").read_text().splitlines()
    head, cells = lines[0].split(","), [line.split(",") for line in lines[1:]]
    tip = [row[head.index("distal_tension_N")] for row in cells]
    assert (tip.count(""), tip[400]) == (50, "")
    assert [row[head.index("distal_tension_residual_N")] for row in cells].count("") == 50
    assert re.search(r"lost\.csv +\| fitted \| 750 +\| 0 ", out)  # samples and spikes of the force


@pytest.mark.parametrize("word", ["distal_tension", "tip=1", "distal_tension=-1", "time=nan"])
def test_noise_that_is_none_is_refused(refused, csv, word):
    assert refused("diagnose", csv, "--noise", word).startswith(f"teleop: --noise {word}: expected")


def test_the_page_needs_nothing_but_itself(report, folder):
    page = (folder / "out" / "report.html").read_text()
    assert f"<h1>{report['headline']}</h1>" in page
    assert "_" not in report["headline"]
    shown, _, folded = page.partition("<details>")
    assert report["sentence"] in shown
    assert (shown.count("<img"), shown.count("<table>"), shown.count('class="card"')) == (1, 1, 1)
    assert f"tendon-teleop {report['version']}" in shown
    assert "friction coordinate" in folded
    words = re.sub(r'base64,[^"]*', "", page)  # in which any four letters occur
    assert not re.search(r"http|<script|<link|@import|url\(", words)
    assert all(source.startswith("data:image/") for source in re.findall(r'src="([^"]+)"', page))
    assert page.count("<img") == 9  # time, loop, left out of either; validation, structure, ranking


def test_the_report_has_validation_and_each_file_left_out(report, folder, csv):
    (kept,) = report["validation"]
    assert kept["file"] == str(folder / "third.csv")
    assert (kept["start"], kept["end"]) == (0.0, pytest.approx(9.98))
    assert kept["channels"]["distal_tension"]["samples"] == 500
    assert [one["file"] for one in report["left_out"]] == [str(csv), str(folder / "second.parquet")]
    assert [one["validation"] for one in report["forces"]] == [False, False, True]
    read = [f"{each['file']}: {format_read_summary(each)}" for each in report["read_as"]]
    assert read[2] == f"{kept['file']}: 500 samples, 9.98 s, 50 Hz"
    page = (folder / "out" / "report.html").read_text()
    assert all(f"<li>{line}</li>" in page for line in read)
    assert report["rivals"] == []


def test_a_supplement_has_what_a_paper_needs(report, folder):
    out = folder / "supplement"
    page = (out / "supplement.html").read_text()
    assert "<h1>Model of bench.csv and 1 more: distal_tension_gain</h1>" in page
    assert f"tendon-teleop {report['version']}" in page
    assert re.search(r"Date: \d{4}-\d\d-\d\d", page)
    assert "teleop diagnose" in page
    assert "--leave-one-file-out" in page
    assert "third.csv: 500 samples, 9.98 s, 50 Hz" in page
    assert "Phee, S. J." in page
    assert not re.search(r"<script|<link|@import", page)
    assert page.count("<svg") == len(list(out.glob("*.svg"))) >= 4 + 7
    with (out / "parameters.csv").open() as file:
        assert file.readline().strip() == "parameter,value,95 % interval"
    for name in ("errors", "validation", "left-out", "forces", "models"):
        assert (out / f"{name}.csv").stat().st_size > 50
    residuals = read_columns(out / "residuals-1.csv").columns
    off = residuals["distal_tension_N"] - residuals["distal_tension_extended_N"]
    assert residuals["distal_tension_residual_N"] == pytest.approx(off)
    correlation = read_columns(out / "autocorrelation-distal_tension.csv").columns
    assert correlation["autocorrelation"][0] == 1.0
    assert abs(correlation["autocorrelation"][1:]).max() < 0.5  # white noise is left


def test_options_that_contradict_the_data_are_refused(csv, refused):
    words = [csv, "--effects", f"{FAULT},creep"]
    assert "give at least two files" in refused("diagnose", *words, "--leave-one-file-out")
    assert "did you mean 'creep'" in refused("diagnose", *words, "--cause", "crep")


def test_the_model_is_what_was_reported(report, folder):
    model, duration, *_ = model_file.load(folder / "out" / "model.yaml")
    assert duration == pytest.approx(16.0 - 0.02)
    K, compliance, tip = model.shared
    ((effect, (gain,)),) = model.effects
    found = {"K": K, "L/EA": compliance, "tip compliance": tip, f"{effect.name}.gain": gain}
    assert found == {name: one["value"] for name, one in report["parameters"].items()}


def test_the_verdict_comes_first_and_a_cause_is_compared_with_a_calibration(csv, folder, capsys):
    calibration = folder / "sheath.yaml"
    calibration.write_text("tendons: [{effective_friction: 2.0, length: 1.0}]\n")
    words = ["diagnose", csv, "--effects", FAULT, "--calibration", calibration]
    assert commands.main([*map(str, words)]) == 0
    said = capsys.readouterr()
    headline = "One thing is wrong: the load cell at the tip has a wrong gain ("
    assert said.out.startswith(headline)
    assert "\nThe model is wrong because the load cell at the tip" in said.out
    assert re.search(r"\| K +\| 2 +\| 0\.9\d+ .* NO +\|", said.out)
    assert "Hang known weights" in said.out
    assert said.out.endswith(f"\n\nread as: {csv}: 800 samples, 15.98 s, 50 Hz\n")
    assert "fitting candidates ..." in said.err.splitlines()


def test_unknown_effects_are_refused_with_what_may_be_meant(csv, refused):
    line = refused("diagnose", csv, "--effects", "creep,fricton_step")
    assert line.startswith(
        "teleop: --effects fricton_step: no such effect; did you mean 'friction_s"
    )


def test_data_that_cannot_be_diagnosed_are_refused_in_one_line(csv, data, tmp_path, refused):
    assert "file not found" in refused("diagnose", tmp_path / "none.csv")
    alone = tmp_path / "alone.csv"
    tension = {"time_s": data.time, "proximal_tension_N": data.channels["proximal_tension"]}
    write_table(alone, tension)
    assert f"{alone}: proximal_tension alone" in refused("diagnose", alone)
    assert "need the same channels" in refused("diagnose", csv, alone)
    short = write(tmp_path / "short.csv", data, slice(0, 50))
    assert f"{short}: 50 samples" in refused("diagnose", short)
    bad = tmp_path / "bad.csv"
    write_table(
        bad, {"time_s": data.time} | columns(data) | {"distal_tension_N": data.time * math.nan}
    )
    assert "no finite value: remove the column" in refused("diagnose", bad)


def test_words_that_cannot_be_right_are_refused_before_anything_is_fitted(csv, tmp_path, refused):
    assert "DATA" in refused("diagnose")
    assert "is a file" in refused("diagnose", csv, "--out", csv)
    strange = tmp_path / "strange.yaml"
    strange.write_text("base: {K: 1}\n")
    assert f"{strange}: base: unknown key" in refused("diagnose", csv, "--calibration", strange)
    assert "--column x" in refused("diagnose", csv, "--column", "x")


def test_the_curves_of_residuals_are_measured_signals_and_both_models(report, folder, data):
    found = read_curves(folder / "out" / "residuals.rrd")
    assert {name for name, _ in found.values()} == {"measured", "before", "after"}
    # a column of panels for each file, for each channel its curves and its residuals
    assert len(found) == 2 * len(COMPARED) * (3 + 2)
    measured, before, after = (found[f"/0/0/{k}"] for k in range(3))
    assert [name for name, _ in (measured, before, after)] == ["measured", "before", "after"]
    assert np.isin(measured[1], data.channels["proximal_tension"]).all()
    for k, (_, model) in enumerate((before, after)):
        name, residual = found[f"/0/1/{k}"]
        assert name == ("before", "after")[k]
        np.testing.assert_allclose(residual, measured[1] - model, atol=1e-12)
    of_tip = [float(np.std(found[f"/0/3/{k}"][1])) for k in range(2)]
    assert of_tip[1] < 0.95 * of_tip[0]  # the gain that was hidden is of the tip's cell


def read_curves(path):
    """Return the name and the values of each entity, by Rerun's own reader."""
    names, values = {}, {}
    for chunk in RrdReader(path).stream():
        table = chunk.to_record_batch()
        for column in table.schema.names:
            if column.endswith("SeriesLines:names"):
                names[chunk.entity_path] = table[column][0].as_py()[0]
            if column.endswith("Scalars:scalars"):
                values[chunk.entity_path] = [x for row in table[column] for x in row.as_py()]
    assert set(names) == set(values)
    return {entity: (names[entity], np.array(values[entity])) for entity in names}
