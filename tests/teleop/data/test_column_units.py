"""Columns in other units of the same dimension are converted, others refused with the remedy."""

import numpy as np
import pytest

from teleop.data.mapping_file import parse_column_options
from teleop.data.measured_table import Columns, read_table, write_table
from teleop.errors import UsageError
from tests.teleop.data.records import pull, refusal


@pytest.mark.parametrize(
    ("channel", "name", "size"),
    [
        ("time", "t_ms", 1e-3),
        ("proximal_displacement", "q (inch)", 0.0254),
        ("proximal_tension", "T_kgf", 9.80665),
        ("proximal_tension", "Force [mN]", 1e-3),
        ("proximal_tension", "T in g", 9.80665e-3),
        ("proximal_tension", "T_in", 1.0),
        ("proximal_displacement", "q[cm]", 1e-2),
        ("time", "t [\N{MICRO SIGN}s]", 1e-6),
        ("proximal_displacement", "q_\N{GREEK SMALL LETTER MU}m", 1e-6),
        ("proximal_tension", "effort[0]", 1.0),
        ("proximal_tension", "Force {kN}", 1e3),
        ("proximal_tension", "Force [kN] of cell 1", 1e3),
        ("proximal_tension", "cell_kN_filtered", 1e3),
        ("proximal_tension", "Load (pounds)", 4.4482216),
        ("time", "datenum [days]", 86400.0),
    ],
)
def test_the_unit_in_a_columns_name_is_heeded_and_said(path, capsys, channel, name, size):
    time, tension = pull(path)
    values = {"time": time, "proximal_displacement": 1e-3 * tension, "proximal_tension": tension}
    column = name.removesuffix("[cm]")
    pull(path.with_suffix(".parquet"), **{column: values[channel] / size})
    table = read_table(path.with_suffix(".parquet"), Columns(**{channel: name}))
    np.testing.assert_allclose(getattr(table, channel), values[channel], rtol=1e-12)
    assert ("converted" in capsys.readouterr().err) == (size != 1.0)


@pytest.mark.parametrize(
    ("channel", "name", "said"),
    [
        ("proximal_tension", "q_mm", "'q_mm' is in mm, and is given as proximal tension"),
        ("proximal_displacement", "q_mm[kgf]", "length is in m, mm"),
        ("distal_tension", "tau_Nm", "is in Nm, and is given as distal tension"),
    ],
)
def test_a_unit_of_another_dimension_is_refused(path, channel, name, said):
    _, tension = pull(path)
    pull(path, q_mm=tension, tau_Nm=tension)
    assert said in refusal(path, columns=Columns(**{channel: name}))


@pytest.mark.parametrize(
    ("channel", "name", "said"),
    [
        ("proximal_tension", "T [counts]", "force is in N, mN, cN, kN, kgf"),
        ("proximal_tension", "T_MN", "unknown unit MN, force is in N, mN"),
        ("proximal_tension", "cell_mV", "unknown unit mV"),
        ("proximal_tension", "T[%]", "unknown unit %"),
        ("time", "t [Ms]", "time is in s, sec, ms"),
    ],
)
def test_an_unknown_unit_is_refused_with_the_known_ones_and_the_option(path, channel, name, said):
    time, tension = pull(path)
    pull(path, **{name: tension if channel == "proximal_tension" else time})
    message = refusal(path, columns=Columns(**{channel: name}))
    assert said in message
    option = message.rpartition("--column ")[2].strip("'")
    assert option.startswith(f"{channel}={name}[")
    with pytest.raises(UsageError):  # no unit is proposed that would pass as it is
        read_table(path, parse_column_options([option]).names)
    named = parse_column_options([option.replace("SCALE", "1")])
    assert len(read_table(path, named.names).time) == len(time)


@pytest.mark.parametrize(
    ("torque", "angle", "newton_metres", "radians"),
    [
        ("tau [N·mm]", "phi [°]", 1e-3, np.pi / 180),
        ("tau (mN m)", "phi °", 1e-3, np.pi / 180),
        ("tau [N*m]", "phi [radians]", 1.0, 1.0),
        ("tau_oz_in", "rev", 0.0070615518, 2.0 * np.pi),
        ("tau [in-lbf]", "deg", 0.11298483, np.pi / 180),
    ],
)
def test_spellings_of_units_of_torque_and_angle(path, torque, angle, newton_metres, radians):
    _, tension = pull(path)
    pull(path, **{torque: tension, angle: tension})
    named = parse_column_options([f"proximal_torque={torque}", f"proximal_angle={angle}"])
    table = read_table(path, named.names, diagnosed=True, units=named.units)
    np.testing.assert_allclose(table.proximal_tension, newton_metres * tension)
    np.testing.assert_allclose(table.proximal_displacement, radians * tension)


@pytest.mark.parametrize("period", [1.0, 0.5])
def test_milliseconds_and_sample_numbers_are_asked_about(path, period):
    _, tension = pull(path)
    write_table(path, {"time_s": period * np.arange(101), "proximal_tension_N": tension})
    said = refusal(path)
    assert "milliseconds, or sample numbers?" in said
    assert read_table(path, Columns("time_s[ms]")).time[1] == pytest.approx(1e-3 * period)
    assert read_table(path, Columns("time_s[s]")).time[1] == period
