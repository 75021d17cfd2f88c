"""Several runs in one file are several records, and never one."""

import numpy as np
import pytest

import teleop
from teleop.cli.commands import main
from teleop.cli.diagnose.diagnosis_run import read_data
from teleop.data.mapping_file import NamedColumns, TableMapping
from teleop.data.measured_table import Columns, read_runs, read_table, write_table
from teleop.errors import UsageError

HEAD = "time_s,proximal_tension_N,proximal_displacement_m"
TIME = np.arange(60) / 50


def tension(run, rows):
    return run + 6.0 - 5.0 * np.cos(3.0 * TIME[:rows])


def rows(run, count=60, start=0.0, form="{:.3f}"):
    """Return the lines of a run, which its tension tells from others."""
    force = tension(run, count)
    return [
        f"{form.format(start + t)},{T:.6f},{0.001 * T:.9f}"
        for t, T in zip(TIME[:count], force, strict=True)
    ]


def add(lines, *cells):
    return [
        f"{line},{cell}" for line, cell in zip(lines, (*cells, *[cells[-1]] * 99), strict=False)
    ]


JOINED = {  # lines, the options, and where runs begin
    "time starts again": ([HEAD, *rows(0), *rows(1), *rows(2, 40)], {}, (2, 62, 122)),
    "nearly at the same time": ([HEAD, *rows(0), *rows(1, start=0.03)], {}, (2, 62)),
    "at a time of day": ([HEAD, *rows(0, start=5e4), *rows(1, 40, start=5e4)], {}, (2, 62)),
    "a time is missing": ([HEAD, *rows(0), ",1.0,0.001", *rows(1)], {"drop": True}, (2, 63)),
    "the names come again": ([HEAD, *rows(0), HEAD, *rows(1, start=1.2)], {}, (2, 63)),
    "the names come again at the end": ([HEAD, *rows(0), HEAD, *rows(1, 40), HEAD], {}, (2, 63)),
    "names and units come again": (
        [HEAD, "s,N,m", *rows(0), "", HEAD, "[s],[N],[m]", *rows(1)],
        {},
        (3, 66),
    ),
    "a column names them": (
        [HEAD + ",Trial No", *add(rows(0), 7), *add(rows(1, 40, start=1.2), 4)],
        {},
        (2, 62),
    ),
    "a name stands in its first row": (
        [HEAD + ",file", *add(rows(0), "a", ""), *add(rows(1, start=9.0), "b", "")],
        {},
        (2, 62),
    ),
    "a column that is said to": (
        [HEAD + ",load", *add(rows(0), 10), *add(rows(1), 20)],
        {"run_column": "load"},
        (2, 62),
    ),
    "numbers of samples": (
        [HEAD.replace("time_s", "n"), *rows(0, form="{:.0f}"), *rows(1, form="{:.0f}")],
        {"rate_hz": 50.0},
        (2, 62),
    ),
}
_count = [line.split(",", 1)[1] for line in JOINED["numbers of samples"][0][1:]]
JOINED["numbers of samples"][0][1:] = [f"{k % 60},{line}" for k, line in enumerate(_count)]


def read(path, lines, drop=False, **mapping):
    path.write_text("\n".join(lines) + "\n")
    columns = Columns(time="n") if lines[0].startswith("n,") else Columns()
    options = {"mapping": TableMapping(**mapping), "diagnosed": True}
    return [run[0] for run in read_runs(path, [columns], drop, **options)]


@pytest.mark.parametrize("kind", JOINED)
def test_each_run_is_a_record_of_its_own(tmp_path, capsys, kind):
    lines, options, first = JOINED[kind]
    runs = read(tmp_path / "x.csv", lines, **options)
    assert [(run.run, run.first) for run in runs] == [
        (k, f"line {line}") for k, line in enumerate(first, 1)
    ]
    for k, run in enumerate(runs):
        count = len(run.time)
        np.testing.assert_allclose(run.time - run.time[0], TIME[:count], atol=1e-9)
        np.testing.assert_allclose(run.proximal_tension, tension(k, count), atol=1e-6)
    assert sum(len(run.time) for run in runs) == sum(line[:1].isdigit() for line in lines)
    assert f"{len(runs)} runs; a new one from line {first[1]}" in capsys.readouterr().err
    (only,) = read(tmp_path / "x.csv", lines, **options | {"run": 2})
    np.testing.assert_array_equal(only.proximal_tension, runs[1].proximal_tension)


def shift(lines, begin, end, seconds):
    """Return lines with other times in some rows."""
    cells = [line.split(",", 1) for line in lines]
    return [
        f"{float(t) + seconds * (begin <= k < end):.3f},{rest}" for k, (t, rest) in enumerate(cells)
    ]


def count_to(end):
    """Return the lines of a record whose time goes on from 0 at an end [s]."""
    pull = ((t, 6 - 5 * np.cos(3 * t)) for t in np.arange(0.0, end + 2.0, 0.02))
    return [f"{t % end:.3f},{T:.4f},{T / 1e3:.7f}" for t, T in pull]


LONG = [*rows(0), *rows(0, start=1.2), *rows(0, start=2.4)]
ONE = {
    "a gap": [HEAD, *rows(0), *rows(1, start=100.0)],
    "a number of the row": [HEAD + ",record", *(f"{line},{k}" for k, line in enumerate(LONG))],
    "the same run throughout": [HEAD + ",run", *add(LONG, 3)],
    "a blank run": [HEAD + ",run", *add(LONG, "")],
}
CLOCK = {
    "one glitch": shift(LONG, 90, 91, -1.8),
    "a glitch of a while": shift(LONG, 90, 130, -1.8),
    "a step back": shift(LONG, 90, 180, -1.0),
    "a step back of little": shift(LONG, 90, 180, -0.03),
    "a short run": [*rows(0), *rows(1, 10)],
    "a counter of 16 bits of milliseconds": count_to(65.536),
    "a counter of 24 bits of microseconds": count_to(16.777216),
}


@pytest.mark.parametrize("kind", ONE)
def test_what_begins_no_run_splits_nothing(tmp_path, kind):
    (run,) = read(tmp_path / "x.csv", ONE[kind])
    assert (run.run, len(run.time)) == (0, len(ONE[kind]) - 1)


@pytest.mark.parametrize("kind", CLOCK)
def test_a_fault_of_the_clock_is_no_run(tmp_path, kind):
    with pytest.raises(UsageError, match=r"time must increase|a second record begins here"):
        read(tmp_path / "x.csv", [HEAD, *CLOCK[kind]])


def test_mixed_rows_of_runs_are_refused_or_said_to_be_one(tmp_path):
    lines = [HEAD + ",run", *(f"{line},{k % 2}" for k, line in enumerate(LONG))]
    with pytest.raises(UsageError, match=r"'run', line 4: 0\.0 comes again.*--run 0"):
        read(tmp_path / "x.csv", lines)
    assert len(read(tmp_path / "x.csv", lines, run=0)[0].time) == 180


def test_a_run_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(UsageError, match="--run 3: the file has 2 runs"):
        read(tmp_path / "x.csv", JOINED["nearly at the same time"][0], run=3)
    with pytest.raises(UsageError, match="has no column 'load'"):
        read(tmp_path / "x.csv", ONE["a gap"], run_column="load")


def test_other_formats_have_runs_too(tmp_path):
    times = np.concatenate([TIME, TIME])
    force = np.concatenate([tension(0, 60), tension(1, 60)])
    write_table(tmp_path / "x.parquet", {"time_s": times, "proximal_tension_N": force})
    runs = read_runs(tmp_path / "x.parquet", [Columns()])
    assert [run[0].first for run in runs] == ["row 1", "row 61"]
    np.testing.assert_array_equal(runs[1][0].proximal_tension, force[60:])


@pytest.fixture
def joined(tmp_path):
    path = tmp_path / "joined.csv"
    path.write_text("\n".join(JOINED["time starts again"][0]) + "\n")
    return path


def test_a_diagnosis_has_a_record_of_each_run(joined, tmp_path):
    (tmp_path / "one.csv").write_text("\n".join([HEAD, *rows(0)]) + "\n")
    paths, named = [tmp_path / "one.csv", joined], NamedColumns(Columns(), None)
    data = read_data(paths, [joined], named, False, TableMapping())
    names = tuple(f"{joined}, run {k}" for k in (1, 2, 3))
    assert data.files == (str(paths[0]), *names)
    assert data.further == names


def test_commands_of_one_record_ask_for_the_run(joined, capsys):
    with pytest.raises(UsageError, match="has 3 runs, one is read here: --run N"):
        read_table(joined)
    joined.with_name("x.csv").write_text("\n".join(JOINED["the names come again"][0]))
    with pytest.raises(UsageError, match="line 63: a second run begins here"):
        teleop.read_recording(joined.with_name("x.csv"))
    words = ["estimate", str(joined), "--config", "configs/demo.yaml"]
    assert main(words) == 2
    assert "--run N" in capsys.readouterr().err
    assert main([*words, "--run", "3"]) == 0
    assert "joined.csv, run 3: 40 samples" in capsys.readouterr().out


def test_data_show_lists_the_runs(joined, capsys):
    assert main(["data", "show", str(joined)]) == 0
    out = capsys.readouterr().out
    assert "| 3   | line 122 | 40      | 0.78         |" in out
    assert "joined.csv, run 1: 60 samples" in out
    assert main(["data", "show", str(joined), "--run", "3"]) == 0
    assert "joined.csv, run 3: 40 samples" in capsys.readouterr().out
