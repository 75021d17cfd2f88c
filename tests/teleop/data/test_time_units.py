"""Times of clocks that are coarse, changed or in another unit: read as they are, or asked about."""

import numpy as np
import pytest

from tests.teleop.data.test_table_parser import (
    MOMENTS,
    NAMES,
    TENSION,
    TIME,
    TRAVEL,
    VALUES,
    check,
    clock,
    read,
    refusal,
    table,
)


def test_times_need_no_name(tmp_path):
    for mark in (",", " -> "):  # an index of pandas, and a serial monitor
        names = ",".join(("" if mark == "," else "x", *NAMES[1:]))
        cells = zip(MOMENTS["ISO" if mark == "," else "time of day"], *VALUES, strict=True)
        rows = [f"{t}{mark}{a:.4f},{b:.7f}" for t, a, b in cells]
        if mark == ",":
            check(read(tmp_path / "x.csv", "\n".join([names, *rows])))
        else:
            said = ["proximal_tension=column 2[N]", "proximal_displacement=column 3[m]"]
            check(read(tmp_path / "x.csv", "\n".join(rows), said))


def test_a_clock_that_is_changed_is_refused(tmp_path):
    for jump, zone, part in (
        (3600, "", "summer time"),
        (-3600, "", "summer time"),
        (-43200, "", "AM or PM"),
        (-3600, ("CEST", "CET"), "'CEST' to 'CET'"),
    ):
        times = [50_000 + t + jump * (t >= 1) for t in TIME]
        cells = [f"{clock(t)} {zone[int(t < 49_000)] if zone else ''}".strip() for t in times]
        text = table(("Time", *NAMES[1:]), ",", ("{}", "{:.4f}", "{:.7f}"), (cells, *VALUES))
        said = refusal(tmp_path / "x.csv", text)
        assert "line 22: the" in said
        assert part in said


@pytest.mark.parametrize(
    ("name", "size", "rate"),
    [
        ("timestamp", 1e3, "(20 Hz)"),
        ("timestamp", 1e6, "(20 Hz)"),
        ("timestamp", 1e9, "(20 Hz)"),
        ("time_s", 1e6, ""),
        ("time_ms", 1e6, ""),
        ("time_us", 1e9, ""),
        ("time_s", 1 / 86400, ""),
        ("time_ms", 1, ""),
    ],
)
def test_the_option_that_a_refusal_names_gives_the_right_times(tmp_path, name, size, rate):
    text = table(
        (name, *NAMES[1:]), forms=["{:.12f}"] * 3, values=((TIME + 9) * size, TENSION, TRAVEL)
    )
    said = refusal(tmp_path / "x.csv", text)
    assert rate in said
    check(read(tmp_path / "x.csv", text, [said.split("--column '")[1].split("'")[0]]))


@pytest.mark.parametrize("period", [0.5, 3.8])
def test_no_unit_is_proposed_where_a_slow_record_is_as_likely(tmp_path, period):
    """Steps of 3.8 are those of milliseconds on a bench, or of seconds of a drive at rest."""
    times = 45.28 + period * np.arange(len(TIME))
    text = table(("Time", *NAMES[1:]), ",", ("{:.6f}", "{:.4f}", "{:.7f}"), (times, *VALUES))
    assert "'time=Time[UNIT]'" in refusal(tmp_path / "x.csv", text)


def test_a_travel_in_micrometres_is_not_proposed_as_millimetres(tmp_path):
    text = table(values=(TIME, TENSION, 1e6 * TRAVEL))
    said = refusal(tmp_path / "x.csv", text)
    check(read(tmp_path / "x.csv", text, [said.split("--column '")[1].split("'")[0]]))


def test_a_record_of_milliseconds_without_a_travel_that_is_too_short_is_asked_about(tmp_path):
    text = table(("time_ms", NAMES[1]), ",", ("{:.3f}", "{:.4f}"), (TIME * 2, TENSION))
    said = refusal(tmp_path / "x.csv", text)
    assert "0.0059 s in all" in said
    found = read(tmp_path / "x.csv", text, [said.split("--column '")[1].split("'")[0]])
    np.testing.assert_allclose(found.time, TIME * 2)


def test_times_in_whole_seconds_tell_the_rate_and_yield_to_it(tmp_path, capsys):
    times = [f"2026-04-10 12:00:{7 + int(t + 0.35):02d}" for t in TIME]
    text = table(("Time", *NAMES[1:]), forms=("{}", "{:.4f}", "{:.7f}"), values=(times, *VALUES))
    assert "but --rate 20" in refusal(tmp_path / "x.csv", text)
    check(read(tmp_path / "x.csv", text, rate_hz=20))
    assert "times of 'Time' are coarse, --rate counts" in capsys.readouterr().err
    assert "--rate 100, but by its whole ticks 20 Hz" in refusal(
        tmp_path / "x.csv", text, rate_hz=100
    )
