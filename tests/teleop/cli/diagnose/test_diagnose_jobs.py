"""Many files, each diagnosed by itself: one line each, a table, and an error ends no other."""

import json

import pytest

from studies import hidden_effects
from teleop.cli import commands
from teleop.data.measured_table import write_table

joblib = pytest.importorskip("joblib")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("records")
    made = hidden_effects.make(5, ("distal_tension_gain",), duration=10.0, rate=50.0)
    columns = {
        "time_s": made.time,
        "proximal_tension_N": made.channels["proximal_tension"],
        "distal_tension_N": made.channels["distal_tension"],
    }
    write_table(folder / "a.csv", columns)
    write_table(folder / "c.csv", {name: y[100:] for name, y in columns.items()})
    (folder / "b.csv").write_text("nothing\n1\n")
    (folder / ".hidden").write_text("not looked at")
    return folder


def test_each_file_is_diagnosed_and_a_bad_one_ends_no_other(folder, tmp_path, capsys):
    words = ["diagnose", folder, "--jobs", 2, "--effects", "distal_tension_gain"]
    words += ["--json", tmp_path / "all.json", "--out", tmp_path / "out"]
    with joblib.parallel_config("threading"):  # of the user; one process here
        assert commands.main([*map(str, words)]) == 2
    said = capsys.readouterr().out
    files = json.loads((tmp_path / "all.json").read_text())["files"]
    assert [item["file"] for item in files] == [str(folder / f"{x}.csv") for x in "abc"]
    assert [bool(item["error"]) for item in files] == [False, True, False]
    for name in ("a.csv", "c.csv"):
        alone = json.loads((tmp_path / "out" / name / "report.json").read_text())
        assert alone in [item["report"] for item in files]
    assert said.count(f"{folder / 'b.csv'}: ") >= 2  # its line, and its row of the table
    assert f"| {folder / 'a.csv'} " in said


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--jobs", "0"], "must be 1 or more"),
        (["--jobs", "2", "--leave-one-file-out"], "of one bench; --jobs takes each by itself"),
    ],
)
def test_options_of_one_bench_are_refused(folder, refused, words, message):
    assert message in refused("diagnose", folder, *words)
