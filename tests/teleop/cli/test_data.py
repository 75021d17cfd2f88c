"""`teleop data show`: how a file is understood, and a mapping with which others are read so."""

import json

import numpy as np
import pytest
import yaml

from teleop.cli.commands import main

TIME = np.arange(100) / 20
TENSION = 6.0 - 5.0 * np.cos(3.0 * TIME)


@pytest.fixture
def bench(tmp_path):
    """Return a table of another lab, with a gap and a missing value."""
    path = tmp_path / "bench.csv"
    rows = [f"{1e3 * t:.1f};{T / 12.5:.6f};{-T:.4f};x" for t, T in zip(TIME, TENSION, strict=True)]
    rows[9] = rows[9].replace(rows[9].split(";")[1], "+OVLD")
    rows = "\n".join(["Lab;B", "t;cell [V];q;note", *rows[:40], *rows[50:]]).replace(".", ",")
    path.write_text(rows + "\n")
    return path


COLUMNS = ("time=t[ms]", "proximal_tension=cell [V][12.5 N]", "proximal_displacement=q[-1 mm]")
OPTIONS = [word for column in COLUMNS for word in ("--column", column)]


def test_it_shows_columns_units_ranges_gaps_and_what_is_missing(bench, tmp_path, capsys):
    words = ["data", "show", str(bench), *OPTIONS]
    shown = [*words, "--json", str(tmp_path / "x.json"), "--figure", str(tmp_path / "x.svg")]
    assert main(shown) == 0
    out = capsys.readouterr().out
    for part in (
        "90 samples, 4.95 s, 20 Hz",
        "semicolons between columns",
        "decimal commas",
        "names in line 2",
        "| proximal_tension      | cell [V] | 12.5 N   | N       |",
        "1 +OVLD (an overload",
        "not used: note",
        "gaps: 1 of more than 1.5 periods, the longest 0.55 s",
    ):
        assert part in out
    found = json.loads((tmp_path / "x.json").read_text())
    assert found["channels"]["proximal_tension"]["missing"] == 1
    assert found["channels"]["proximal_displacement"]["max"] == pytest.approx(0.011, rel=0.01)


def test_the_mapping_that_it_writes_reads_the_file_alike(bench, tmp_path, capsys):
    mapping = tmp_path / "lab.yaml"
    assert main(["data", "show", str(bench), *OPTIONS, "--write-mapping", str(mapping)]) == 0
    by_options = capsys.readouterr().out
    assert yaml.safe_load(mapping.read_text())["columns"]["proximal_displacement"] == {
        "column": "q", "unit": "mm", "scale": -1.0
    }  # fmt: skip
    assert main(["data", "show", str(bench), "--mapping", str(mapping)]) == 0
    assert capsys.readouterr().out == by_options


def test_a_file_that_is_refused_is_listed_with_the_question(bench, capsys):
    assert main(["data", "show", str(bench)]) == 2
    said = capsys.readouterr()
    assert "| cell [V] |" in said.out
    assert "--column 'time=" in said.err


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("column: {}\n", "unknown key; did you mean 'columns'"),
        ("columns: {time: {column: t, scale: 0}}\n", "columns.time.scale: 0.0: must be finite"),
        ("decimal: dot\n", "decimal"),
        ("rate_hz: -5\n", "rate_hz: -5.0: must be above 0"),
    ],
)
def test_a_mapping_is_checked_like_a_config(bench, tmp_path, refused, text, said):
    (tmp_path / "lab.yaml").write_text(text)
    assert said in refused("data", "show", bench, "--mapping", tmp_path / "lab.yaml")
