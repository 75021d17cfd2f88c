"""Tables as other programs write them are read as what they are, or refused with the remedy."""

import re

import numpy as np
import pytest

from teleop.data import read_table
from teleop.data.mapping_file import MappedColumn, TableMapping, parse_column_options
from teleop.errors import UsageError

NAMES = ("time_s", "proximal_tension_N", "proximal_displacement_m")
TIME = np.arange(60) / 20
TENSION = 6.0 - 5.0 * np.cos(3.0 * TIME)
TRAVEL = 0.01 * TENSION / 11.0
VALUES = (TENSION, TRAVEL)


def table(
    names=NAMES,
    sep=",",
    forms=("{:.3f}", "{:.4f}", "{:.7f}"),
    values=(TIME, TENSION, TRAVEL),
    above=(),
    decimal=".",
):
    """Return a table as text."""
    rows = [
        sep.join(
            f.format(v) if isinstance(v, str) else f.format(v).replace(".", decimal)
            for f, v in zip(forms, row, strict=True)
        )
        for row in zip(*values, strict=True)
    ]
    return "\n".join([*above, sep.join(names), *rows]) + "\n"


def read(path, text, columns=(), encoding="utf-8", **mapping):
    path.write_bytes(text.encode(encoding))
    named = parse_column_options(columns)
    return read_table(
        path, named.names, diagnosed=True, units=named.units, mapping=TableMapping(**mapping)
    )


def refusal(path, text, columns=(), **mapping):
    with pytest.raises(UsageError) as caught:
        read(path, text, columns, **mapping)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def check(found, time=TIME):
    np.testing.assert_allclose(found.time - found.time[0], time - time[0], atol=1e-6)
    np.testing.assert_allclose(found.proximal_tension, TENSION, atol=1e-4)
    np.testing.assert_allclose(found.proximal_displacement, TRAVEL, atol=1e-7)


PLAIN = table()
FIRST = PLAIN.splitlines()[0]
DECORATED = {
    "no-break space": PLAIN.replace("time_s,", "time_s\u00a0,"),
    "savetxt": "# " + PLAIN,
    "savetxt, spaces in rows": "# " + FIRST + "\n" + table(sep=" ").partition("\n")[2],
    "comment above": "# bench 3, tendon a\n" + PLAIN,
    "metadata as wide as the table": "Bench,3,\nLab,B,\n,,\n" + PLAIN + ",,\n,,\n",
    "sep=": "sep=;\n" + table(sep=";"),
    "tabs, in Latin-1, with decimal commas": (
        table(above=("Größe\tN",), sep="\t", decimal=","),
        "latin-1",
    ),
    "tabs and quotes": '"' + table(sep='"\t"').replace("\n", '"\n"')[:-1],
    "columns of fixed width": table(sep="   ").replace("\n", "\n  "),
    "German Excel": table(sep=";", decimal=","),
    "quoted decimal commas": '"' + table(sep='","', decimal=",").replace("\n", '"\n"')[:-1],
    "UTF-16": (PLAIN, "utf-16"),
    "units below": PLAIN.replace(FIRST, FIRST + "\ns,N,m"),
    "units below, one missing": PLAIN.replace(FIRST, FIRST + "\n,N,m"),
    "column without a name": PLAIN.replace("\n", ",\n"),
    "minus of typesetting": table(values=(TIME - 1.0, TENSION, TRAVEL)).replace("-", "−"),
    "ends of lines of an old Mac": PLAIN.replace("\n", "\r"),
    "index without a name": "\n".join(
        f"{k - 1 if k else ''},{line}" for k, line in enumerate(PLAIN.splitlines())
    ),
    "words at the end, as wide as the table": PLAIN + ",,\nMETADATA,,\nGear,6.5,\n",
    "a column of comments without cells": PLAIN.replace(NAMES[2], NAMES[2] + ",Comment"),
    "row names of R": "\n".join(
        f'"{k}" {line}' if k else line for k, line in enumerate(table(sep=" ").splitlines())
    ),
    "row numbers of pandas": "\n".join(
        f"{k - 1} {line}" if k else line for k, line in enumerate(table(sep="  ").splitlines())
    ),
    "rules below and above": table(sep=" | ", above=("+---+---+",)).replace(
        NAMES[2], NAMES[2] + "\n--- | --- | ---"
    ),
    "a unit beside each name": table(
        ("proximal_tension", "N", "proximal_displacement", "m", "Time", "s"),
        "  ",
        ("{:.4f}", "{:.7f}", "{:.3f}"),
        (TENSION, TRAVEL, TIME),
    ),
    "a description between names and units": PLAIN.replace(
        FIRST, "time,proximal_tension,proximal_displacement\nPC,cell 1,drive\ns,N,m"
    ),
    "units in each cell": table(
        ("Time", "proximal_tension", "proximal_displacement"),
        forms=("{:.3f} sec", "{:.4f} N", "{:.7f}m"),
    ),
    "Windows-1252": (table(above=("Größe “3” €",), sep=";"), "cp1252"),
    "numbered as of tendon 1": PLAIN.replace("tension_N", "tension_1_N").replace(
        "displacement_m", "displacement_1_m"
    ),
    "exponents of Fortran": table(forms=("{:.3f}", "{:.8E}", "{:.8E}")).replace("E", "D"),
}


@pytest.mark.parametrize("kind", DECORATED)
def test_a_table_is_read_however_it_is_written(tmp_path, kind):
    text, encoding = DECORATED[kind], "utf-8"
    text, encoding = text if isinstance(text, tuple) else (text, encoding)
    check(read(tmp_path / "x.csv", text, encoding=encoding))


@pytest.mark.parametrize(
    ("names", "units", "sizes"),
    [
        (("Time [ms]", "Proximal Tension [kgf]", "proximal-displacement (mm)"), "", (1e3, 1, 1e3)),
        (("t_min", "proximal_tension_lbf", "proximal_displacement_um"), "", (1 / 60, 1, 1e6)),
        (("time", "proximal_tension", "proximal_displacement"), "ms,N,mm", (1e3, 1, 1e3)),
        (("TIME", "PROXIMAL_TENSION", "PROXIMAL_DISPLACEMENT"), "sec,gf,in", (1, 1, 1 / 0.0254)),
    ],
)
def test_units_that_a_table_states_are_converted_and_said(tmp_path, capsys, names, units, sizes):
    force = {"kgf": 9.80665, "lbf": 4.4482216, "gf": 9.80665e-3}
    stated = next((size for unit, size in force.items() if unit in names[1] + units), 1.0)
    values = (TIME * sizes[0], TENSION / stated, TRAVEL * sizes[2])
    text = table(names, forms=["{:.9f}"] * 3, values=values)
    found = read(tmp_path / "x.csv", text.replace("\n", f"\n{units}\n", 1) if units else text)
    check(found)
    assert ("converted" in capsys.readouterr().err) == (names != NAMES)


BARE = PLAIN.partition("\n")[2]


@pytest.mark.parametrize(
    ("text", "names"),
    [
        (BARE, ("column 1", "column 2", "column 3")),
        ("=~=~ PuTTY log =~=~\n1.2,0.1\n" + BARE, ("column 1", "column 2", "column 3")),
        (table(sep="\t", decimal=",").partition("\n")[2], ("column 1", "column 2", "column 3")),
        ("# bench 3, tendon a\n% 20 Hz\n" + BARE, ("column 1", "column 2", "column 3")),
        ("# bench 3\n1,2,3\n" + BARE, ("1", "2", "3")),
        (",0,1,2\n" + re.sub(r"(?m)^(?=\d)", "7,", BARE), ("0", "1", "2")),
    ],
)
def test_columns_without_names_are_named_by_number(tmp_path, capsys, text, names):
    path = tmp_path / "x.log"
    assert f"it has {', '.join(names)}" in refusal(path, text).replace(
        "it has column 1, 0", "it has 0"
    )
    channels = zip(("time", "proximal_tension", "proximal_displacement"), names, "sNm", strict=True)
    check(read(path, text, [f"{channel}={name}[{unit}]" for channel, name, unit in channels]))
    assert ("column 1 to column 3" in capsys.readouterr().err) == (names[0] == "column 1")


def clock(time):
    return f"{int(time) // 3600:02d}:{int(time) // 60 % 60:02d}:{time % 60:06.3f}"


MOMENTS = {
    "ISO": [f"2026-04-10T{clock(70_000 + t)}" for t in TIME],
    "time of day": [clock(70_000 + t) for t in TIME],
    "past midnight": [clock((86_399 + t) % 86_400) for t in TIME],
    "ISO past midnight": [
        f"2026-{'02-28' if t < 1 else '03-01'}T{clock((86_399 + t) % 86_400)}" for t in TIME
    ],
    "German date": [f"{12 + (t >= 1)}.05.2026 {clock((86_399 + t) % 86_400)}" for t in TIME],
    "pandas": [f"{1 + (t >= 1)} days {clock((86_399 + t) % 86_400)}" for t in TIME],
    "a zone in hours": [f"2026-04-10 {clock(7000 + t)}+02" for t in TIME],
    "afternoon": [f"04/10/2026 {clock(36_000 + t)} PM" for t in TIME],
}


@pytest.mark.parametrize("kind", MOMENTS)
def test_dates_and_times_of_day_are_seconds_from_the_first(tmp_path, kind):
    text = table(
        ("Time", *NAMES[1:]),
        forms=("{}", "{:.4f}", "{:.7f}"),
        values=(MOMENTS[kind], TENSION, TRAVEL),
    )
    check(read(tmp_path / "x.csv", text))


def test_a_date_beside_a_time_of_day_tells_the_day(tmp_path):
    days = ["12.05.2026" if t < 1 else "13.05.2026" for t in TIME]
    values = (days, MOMENTS["past midnight"], TENSION, TRAVEL)
    text = table(
        ("Date", "Time", *NAMES[1:]), forms=("{}", "{}", "{:.4f}", "{:.7f}"), values=values
    )
    check(read(tmp_path / "x.csv", text, ["time=Time"]))
    later = text.replace("13.05.2026,00:00:00.000", "14.05.2026,23:59:59.999")
    assert "'14.05.2026' comes after '12.05.2026'" in refusal(tmp_path / "x.csv", later)


def test_minutes_and_seconds_need_a_format(tmp_path):
    moments = [f"05:{t:06.3f}" for t in TIME]
    values = (moments, TENSION, TRAVEL)
    text = table(("Time", *NAMES[1:]), forms=("{}", "{:.4f}", "{:.7f}"), values=values)
    assert "line 2: '05:00.000' is not" in refusal(tmp_path / "x.csv", text, ["time=Time"])
    check(read(tmp_path / "x.csv", text, ["time=Time"], time_format="%M:%S.%f"))


def test_notes_beside_a_table_are_left_out_and_said(tmp_path, capsys):
    notes = re.sub(r"(?m)$", ",,", PLAIN.strip()).replace("2.950,", "2.95,") + "\n"
    check(read(tmp_path / "x.csv", notes))
    assert capsys.readouterr().err == ""
    line = notes.splitlines()[5]
    noted = notes.replace(line, f"{line[:-1]},mean,1.2")
    assert "has 6 cells" in refusal(tmp_path / "x.csv", noted)
    check(read(tmp_path / "x.csv", notes.replace(line, f"{line[:-2]},mean,1.2")))
    assert "cells right of 'proximal_displacement_m', without names" in capsys.readouterr().err


def test_a_sign_a_scale_and_a_zero_are_given_with_the_unit(tmp_path):
    values = (TIME, TENSION / 12.5, -1e3 * TRAVEL)
    text = table(("t_s", "load [V]", "q"), forms=["{:.7f}"] * 3, values=values)
    columns = ["proximal_tension=load [V]", "proximal_displacement=q[-1 mm]"]
    said = refusal(tmp_path / "x.csv", text, columns)
    assert "unknown unit V" in said
    assert "12.5 N" in said
    check(read(tmp_path / "x.csv", text, ["proximal_tension=load [V][12.5 N]", columns[1]]))
    raw = table(
        ("t_s", "cell", "q"), forms=["{:.7f}"] * 3, values=(TIME, 8060 + TENSION, values[2])
    )
    cell = MappedColumn(column="cell", unit="N, zero 8060")
    check(read(tmp_path / "x.csv", raw, [f"proximal_tension={cell.format_option()}", columns[1]]))
    said = refusal(tmp_path / "x.csv", raw, ["proximal_tension=cell[N, zero x]"])
    assert "column 'cell': 'x' is not its reading at zero" in said


@pytest.mark.parametrize(
    "word", ["N/A", "nan", "null", "--", "#N/A", "1.#QNAN", "<NA>", "nan(ind)", "n.a.", ""]
)
def test_words_for_missing_values_are_missing_and_counted(tmp_path, capsys, word):
    cells = [word if k in (7, 8) else f"{v:.4f}" for k, v in enumerate(TENSION)]
    text = table(forms=("{:.3f}", "{}", "{:.7f}"), values=(TIME, cells, TRAVEL))
    found = read(tmp_path / "x.csv", text)
    assert np.flatnonzero(np.isnan(found.proximal_tension)).tolist() == [7, 8]
    assert (f"2 {word} (missing)" in capsys.readouterr().err) == (word not in ("", "nan"))


@pytest.mark.parametrize(
    ("word", "said"),
    [("****", "range"), ("-O.L", "range"), ("#DIV/0!", "an error"), ("#¡VALOR!", "an error")],
)
def test_an_overload_is_named(tmp_path, capsys, word, said):
    cells = [word if k == 7 else f"{v:.4f}" for k, v in enumerate(TENSION)]
    read(tmp_path / "x.csv", table(forms=("{:.3f}", "{}", "{:.7f}"), values=(TIME, cells, TRAVEL)))
    err = capsys.readouterr().err
    assert f"1 {word} (" in err
    assert said in err


@pytest.mark.parametrize(
    ("sep", "decimal", "group"),
    [(",", ".", ","), (";", ",", "."), (";", ".", "'"), ("\t", ",", " ")],
)
def test_thousands_separators_are_told_from_decimal_signs(tmp_path, capsys, sep, decimal, group):
    cells = [f"{v:,.1f}".translate({44: group, 46: decimal}) for v in 150.0 * TENSION]
    cells = [f'"{cell}"' for cell in cells]
    text = table(
        sep=sep, decimal=decimal, forms=("{:.3f}", "{}", "{:.7f}"), values=(TIME, cells, TRAVEL)
    )
    found = read(tmp_path / "x.csv", text, ["proximal_tension=proximal_tension_N[mN]"])
    np.testing.assert_allclose(found.proximal_tension, 0.15 * TENSION, atol=1e-4)
    assert "thousands separators in" in capsys.readouterr().err


@pytest.mark.parametrize(("sep", "group"), [(";", "'"), ("|", "\u00a0"), (" ", "\u00a0")])
def test_other_separators_of_thousands_leave_one_sign_for_decimals(tmp_path, sep, group):
    names = ("time_us", "proximal_tension_N")
    times = [f"{50_000 * k:,}".replace(",", group) for k in range(1, 61)]
    tension = 2.0 + 0.001 * np.arange(60)
    text = table(names, sep, ("{}", "{:.3f}"), (times, tension), decimal=",")
    found = read(tmp_path / "x.csv", text)
    np.testing.assert_allclose(found.proximal_tension, tension)
    np.testing.assert_allclose(found.time, 0.05 * np.arange(1, 61))


def test_a_number_that_may_be_of_thousands_is_asked_about(tmp_path):
    time, tension = np.arange(60), 2.0 + 0.001 * np.arange(60)
    text = table(NAMES[:2], ";", ("{}", "{:.3f}"), (time, tension))
    assert "--decimal point or --decimal comma" in refusal(tmp_path / "x.csv", text, rate_hz=20)
    found = read(tmp_path / "x.csv", text, rate_hz=20, decimal="point")
    np.testing.assert_allclose(found.proximal_tension, tension)
    found = read(
        tmp_path / "x.csv",
        text,
        ["proximal_tension=proximal_tension_N[mN]"],
        rate_hz=20,
        decimal="comma",
    )
    np.testing.assert_allclose(found.proximal_tension, tension)


WHOLE = table(values=(1000 * TIME / 50, TENSION, TRAVEL), forms=("{:.0f}", "{:.4f}", "{:.7f}"))
SLOW = table(values=(1000 * TIME / 200, TENSION, TRAVEL))
REFUSED = {
    "milliseconds or sample numbers": (WHOLE, ["samples are 1 s apart", "[ms]'", "--rate"]),
    "milliseconds of 4 kHz": (
        table(values=(TIME * 5, TENSION, TRAVEL / 1e3)),
        ["unit of time", "'time=time_s[ms]'"],
    ),
    "milliseconds of hours": (
        table(values=(TIME * 1e4 / 5, TENSION, TRAVEL)),
        ["milliseconds", "[ms]'"],
    ),
    "a counter that overflows": (
        table(("time_us", *NAMES[1:]), values=((4.294e9 + 1e6 * TIME) % 2**32, *VALUES)),
        ["line 22", "the counter begins anew", "add 4294.967296 s"],
    ),
    "a page in place of a table": ("<html><table><tr><td>1", ["HTML: save it as .csv"]),
    "hours": (table(values=(TIME / 3600, TENSION, TRAVEL), forms=["{:.9f}"] * 3), ["hours"]),
    "a thousand times too fast": (
        table(values=(TIME / 1000, TENSION, TRAVEL), forms=["{:.9f}"] * 3),
        ["m/s", "unit of time"],
    ),
    "a name that says milliseconds of seconds": (
        table(
            ("Time [ms]", *NAMES[1:]), values=(TIME / 100, TENSION, TRAVEL), forms=["{:.7f}"] * 3
        ),
        ["seconds, minutes", "'time=Time [ms][s]'"],
    ),
    "numbered devices in turn": (
        "\n".join([FIRST + ",id", *(f"{r},{k}" for r in BARE.splitlines() for k in (3, 4))]) + "\n",
        ["line 3: 0.0 does not", "column 'id' names devices in turn: keep the rows of one"],
    ),
    "a clock that is coarse": (
        "\n".join([FIRST, *(row for row in BARE.splitlines() for _ in "12")]) + "\n",
        ["line 3: 0.0 does not", "60 are equal", "--rate 40"],
    ),
    "a clock that stands": (re.sub(r"(?m)^\d\.\d+", "7", PLAIN), ["59 are equal", "--rate HZ"]),
    "rows of two sources": (
        "\n".join([FIRST, *(f"{k / 40},{k},\n{(k + 0.5) / 40},,0.001" for k in range(60))]) + "\n",
        ["no row has both 'proximal_tension_N' and 'proximal_displacement_m'", "interpolate"],
    ),
    "a tension below zero": (
        table(values=(TIME, TENSION - 5.0, TRAVEL)),
        ["cannot push", "--column 'proximal_tension=proximal_tension_N[N, zero -4]' or [-1 N]"],
    ),
    "a name twice": (PLAIN.replace(NAMES[2], NAMES[1]), ["2 times", "rename all but one"]),
    "commas between and in numbers": (table(decimal=","), ["commas in numbers"]),
    "both decimal signs": (table(sep=";").replace("0.050;", "0,050;"), ["line 3", "'0,050'"]),
    "units twice": (PLAIN.replace(FIRST, FIRST + "\nms,N,m"), ["name says s", "[s]'"]),
    "units in cells": (PLAIN.replace("1.0000,", "1.0000 N,"), ["line 2: '1.0000 N'", "its unit"]),
    "two columns of time": (
        PLAIN.replace("time_s,proximal_tension_N", "time_ms,Time [us]"),
        ["which is it, 'time_ms'"],
    ),
    "no tension at the housing": (PLAIN.replace(NAMES[1], "distal_tension_N"), ["load cell"]),
    "two tensions": (
        PLAIN.replace(NAMES[1], "tension_a_N").replace(NAMES[2], "tension_b_N"),
        ["tension_a_N and tension_b_N", "--column 'proximal_tension=tension_a_N'", "teleop pair"],
    ),
    "no tension": ("\n".join(f"{line.split(',')[0]},1" for line in PLAIN.split()), ["load cell"]),
    "a current": (PLAIN.replace(NAMES[1], "motor_current_A"), ["no column 'proximal_tension_N'"]),
    "a line of numbers alone": ("1.5,2,3\n", ["must contain the column names"]),
    "words between numbers": (
        PLAIN.replace("2.000,", "stopped\n2.000,"),
        ["line 42: has 1 cells, line 1 names 3 columns", "remove it"],
    ),
    "a cut last line": (PLAIN + "3.000,1.2", ["line 62: has 2 cells", "remove this line"]),
    "a number for missing ones": (PLAIN.replace("1.0000,", "-9999,"), ["-9999 a missing value?"]),
    "an exponent alone": (table(sep=";", decimal=",").replace("1,0000;", "e2;"), ["'e2' is not"]),
    "an open quote far down": (PLAIN.replace("2.950,", '2.950,"'), ["cannot be read"]),
    "unknown words": (PLAIN.replace("1.0000,", "broken,"), ["line 2: 'broken'", "blank"]),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_what_may_be_wrong_is_refused_with_the_remedy(tmp_path, kind):
    text, parts = REFUSED[kind]
    said = refusal(tmp_path / "x.csv", text)
    for part in parts:
        assert part in said


@pytest.mark.parametrize("spikes", [(), (13,), (13, 14), (5, 30, 55)])
def test_spikes_of_the_travel_change_nothing_of_its_speed(tmp_path, spikes):
    travel, missing = TRAVEL.copy(), ["" if k == 20 else f"{v:.7f}" for k, v in enumerate(TRAVEL)]
    travel[list(spikes)] += 0.5  # [m] in 50 ms
    forms = ["{:.9f}"] * 3
    found = read(tmp_path / "x.csv", table(values=(TIME, TENSION, travel), forms=forms))
    np.testing.assert_allclose(found.proximal_displacement, travel, atol=1e-9)
    for k in spikes:
        missing[k] = f"{TRAVEL[k] + 0.5:.7f}"
    for size, slower in ((1e-3, 1.0), (7.0, 100.0)):  # 20 kHz, and 2.9 Hz of a hundredth of it
        cells = [f"{float(cell) / slower:.9f}" if cell else "" for cell in missing]
        text = table(values=(size * TIME, TENSION, cells), forms=("{:.9f}", "{:.4f}", "{}"))
        said = refusal(tmp_path / "x.csv", text)
        assert "is the unit of time right?" in said


def test_sample_numbers_have_a_rate(tmp_path):
    check(read(tmp_path / "x.csv", WHOLE, rate_hz=20))
    check(
        read(
            tmp_path / "x.csv",
            table(NAMES[1:], ",", ("{:.4f}", "{:.7f}"), (TENSION, TRAVEL)),
            rate_hz=20,
        )
    )
    assert "does not number samples" in refusal(tmp_path / "x.csv", PLAIN, rate_hz=20)


@pytest.mark.parametrize("turns", [7.2, -12.4, 57.3])
def test_a_winch_of_many_turns_is_asked_about_once(tmp_path, turns):
    names = ("time_s", "proximal_torque_Nm", "proximal_angle_rad")
    angle = 2.0 * np.pi * turns * TRAVEL / np.ptp(TRAVEL)
    text = table(names, values=(TIME, TENSION / 1e3, angle), forms=["{:.6f}"] * 3)
    said = refusal(tmp_path / "x.csv", text)
    assert f"degrees, or {abs(turns):.1f} turns?" in said
    option = said.split("--column '")[1].split("'")[0]
    found = read(tmp_path / "x.csv", text, [option])
    np.testing.assert_allclose(found.proximal_displacement, np.radians(angle), atol=1e-6)
    found = read(tmp_path / "x.csv", text, [option.replace("[deg]", "[rad]")])
    np.testing.assert_allclose(found.proximal_displacement, angle, atol=1e-6)


def test_a_large_force_passes_once_its_unit_is_stated(tmp_path):
    text = table(values=(TIME, 400.0 * TENSION, TRAVEL))
    said = refusal(tmp_path / "x.csv", text)
    option = said.split("--column '")[1].split("'")[0].replace("[mN]", "[N]")
    assert read(tmp_path / "x.csv", text, [option]).proximal_tension.max() > 4000.0


def test_a_file_of_another_kind_is_named(tmp_path):
    np.savez(tmp_path / "x.npz", time=TIME)
    (tmp_path / "x.npz").rename(tmp_path / "x.csv")
    with pytest.raises(UsageError, match="is no text, but a spreadsheet"):
        read_table(tmp_path / "x.csv")


def test_text_of_a_test_machine_or_an_oscilloscope_is_read(tmp_path):
    check(read(tmp_path / "x.tra", PLAIN))
    (tmp_path / "x.raw").write_bytes(TIME.tobytes())
    with pytest.raises(UsageError, match="unknown kind of file"):
        read_table(tmp_path / "x.raw")
    text = "x-axis,1,2\nsecond,Volt,Volt\n" + BARE
    columns = ["time=x-axis", "proximal_tension=1", "proximal_displacement=2[1 m]"]
    said = refusal(tmp_path / "x.csv", text, columns)
    assert "column '1': unknown unit Volt" in said
    columns[1] = said.split("--column '")[1].split("'")[0].replace("SCALE", "1")
    check(read(tmp_path / "x.csv", text, columns))


def test_names_below_the_last_header_of_labview_are_found(tmp_path):
    head = "LabVIEW Measurement\nTime\t11:10:31.1\n***End_of_Header***\t\n\nChannels\t2\n"
    head += "Samples\t40\t40\t\nX_Dimension\tTime\tTime\nX0\t0.0E+0\t0.0E+0\n"
    head += "***End_of_Header***\t\t\t\nX_Value\tForce_0\tPosition_0\tComment\n"
    columns = ["proximal_tension=Force_0[N]", "proximal_displacement=Position_0[m]"]
    text = head + BARE.replace(",", "\t")
    assert "'time=X_Value[UNIT]'" in refusal(tmp_path / "x.lvm", text, columns)
    check(read(tmp_path / "x.lvm", text, ["time=X_Value[s]", *columns]))
