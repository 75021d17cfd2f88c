"""Column names tell the units of a record, and contradictions are refused with the right name."""

import numpy as np
import pytest

from estimator.units import FORCE, LINEAR, ROTARY
from teleop.cli.diagnose.options import parse_column_options, parse_noise
from teleop.data.table import Columns, read_table, write_table
from teleop.errors import UsageError

ROTARY_NAMES = ("proximal_torque_Nm", "proximal_angle_rad", "distal_torque_Nm")


@pytest.fixture
def path(tmp_path):
    return tmp_path / "joint.csv"


def written(path, *names):
    time = np.arange(5) / 10
    swing = np.array([0.2, 0.1, -0.3, -0.2, 0.0])
    write_table(path, {"time_s": time} | dict.fromkeys(names, swing))
    return path


def refusal(path, **options):
    with pytest.raises(UsageError) as caught:
        read_table(path, **options)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_torque_and_angle_are_read_with_either_sign(path):
    table = read_table(written(path, *ROTARY_NAMES), diagnosed=True)
    assert table.units == ROTARY
    assert table.proximal_tension.min() == -0.3
    assert table.distal_displacement is None
    assert list(table.columns()) == ["time_s", *ROTARY_NAMES]


def test_of_a_second_joint_too(path):
    written(path, "proximal_torque_2_Nm", "proximal_angle_2_rad")
    table = read_table(path, Columns.of_tendon(2), diagnosed=True)
    assert table.units == ROTARY
    assert table.proximal_displacement is not None


def test_forces_of_either_sign_are_named_forces(path):
    written(path, "proximal_force_N", "proximal_displacement_m")
    assert read_table(path, diagnosed=True).units == FORCE
    columns = {"time_s": np.arange(5.0) / 10, "proximal_tension_N": np.arange(5.0) - 2.0}
    write_table(path, columns)
    assert "a closed loop's forces are named proximal_force_N" in refusal(path, diagnosed=True)


def test_only_a_diagnosis_reads_them(path):
    assert "only `teleop diagnose` reads these" in refusal(written(path, *ROTARY_NAMES))


@pytest.mark.parametrize(
    ("names", "parts"),
    [
        (["proximal_tension_Nm"], ["is a torque, not a tension", "'proximal_torque_Nm'"]),
        (["proximal_tension_2_Nm"], ["'proximal_torque_2_Nm'"]),
        (["proximal_torque_Nm", "proximal_displacement_rad"], ["'proximal_angle_rad'"]),
        (["proximal_torque_Nm", "proximal_angle_deg"], ["not in radians", "'proximal_angle_rad'"]),
        (["proximal_torque_Nmm"], ["not in newton metres"]),
        (["proximal_torque_Nm", "distal_tension_N"], ["as a whole", "'distal_tension_N'"]),
        (["proximal_tension_N", "proximal_angle_rad"], ["as a whole"]),
        (["proximal_tension_N", "distal_force_N"], ["both forces"]),
    ],
)
def test_a_name_that_contradicts_its_unit_is_refused_with_the_right_one(path, names, parts):
    message = refusal(written(path, *names), diagnosed=True)
    for part in parts:
        assert part in message


def test_a_further_column_of_a_linear_record_is_no_contradiction(path):
    names = ("proximal_tension_N", "proximal_displacement_m", "proximal_angle_deg")
    time = np.arange(5) / 10
    write_table(path, {"time_s": time} | dict.fromkeys(names, time))
    table = read_table(path, diagnosed=True)
    assert table.units == LINEAR
    assert "proximal_angle_deg" in table.extra


def test_degrees_and_newton_millimetres_are_noticed(path):
    time = np.arange(5) / 10
    write_table(path, {"time_s": time, "proximal_torque_Nm": 5e3 * time})
    assert "N mm" in refusal(path, diagnosed=True)
    columns = {"time_s": time, "proximal_torque_Nm": time, "proximal_angle_rad": 400.0 * time}
    write_table(path, columns)
    assert "in radians" in refusal(path, diagnosed=True)


def test_own_names_tell_the_units_by_the_channels_name(path):
    written(path, "tau_Nm", "phi")
    named = parse_column_options(["proximal_torque=tau_Nm", "proximal_angle=phi"])
    table = read_table(path, named.names, diagnosed=True, units=named.units)
    assert table.units == ROTARY
    named = parse_column_options(["proximal_tension=tau_Nm"])
    assert "--column proximal_torque=tau_Nm" in refusal(
        path, columns=named.names, diagnosed=True, units=named.units
    )
    with pytest.raises(UsageError, match="as a whole"):
        parse_column_options(["proximal_torque=a", "distal_tension=b"])


def test_noise_is_given_by_either_name():
    assert parse_noise(["proximal_angle=1e-4"]) == {"proximal_displacement": 1e-4}


def pull(path, **columns):
    """Write a pull of 1 s at 100 Hz, with further columns."""
    time = np.arange(101) / 100
    tension = 5.0 - 4.0 * np.cos(6.0 * time)
    write_table(path, {"time_s": time, "proximal_tension_N": tension} | columns)
    return time, tension


@pytest.mark.parametrize(
    ("channel", "name", "size"),
    [
        ("time", "t_ms", 1e-3),
        ("time", "Time [us]", 1e-6),
        ("time", "t_min", 60.0),
        ("proximal_displacement", "q_mm", 1e-3),
        ("proximal_displacement", "q (inch)", 0.0254),
        ("proximal_displacement", "Q_MM", 1e-3),
        ("proximal_tension", "T_kgf", 9.80665),
        ("proximal_tension", "Force [mN]", 1e-3),
        ("proximal_tension", "T in g", 9.80665e-3),
        ("proximal_displacement", "q_in", 1.0),
        ("proximal_tension", "T_min", 1.0),
        ("proximal_tension", "T_in", 1.0),
        ("proximal_displacement", "q[cm]", 1e-2),
        ("time", "t [\N{GREEK SMALL LETTER MU}s]", 1e-6),
        ("time", "t [\N{MICRO SIGN}s]", 1e-6),
        ("time", "Time (Seconds)", 1.0),
        ("proximal_displacement", "q_\N{GREEK SMALL LETTER MU}m", 1e-6),
        ("proximal_displacement", "q_nm", 1e-9),
        ("proximal_tension", "effort[0]", 1.0),
        ("proximal_tension", "T_Min", 1.0),
        ("proximal_tension", "T_KN", 1e3),
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
        ("time", "q_mm", "is in mm, and is given as time"),
        ("proximal_displacement", "q_mm[kgf]", "length is in m, mm"),
        ("distal_tension", "tau_Nm", "is in Nm, and is given as distal tension"),
        ("distal_tension", "T [s]", "is in s, and is given as distal tension"),
    ],
)
def test_a_unit_of_another_dimension_is_refused(path, channel, name, said):
    _, tension = pull(path)
    pull(path, q_mm=tension, tau_Nm=tension, **{"T [s]": tension})
    assert said in refusal(path, columns=Columns(**{channel: name}))


UNKNOWN_UNITS = [
    ("proximal_tension", "T [counts]", "force is in N, mN, cN, kN, kgf"),
    ("proximal_tension", "T [dN]", "force is in N, mN"),
    ("proximal_tension", "T [MN]", "unknown unit MN, force is in N, mN"),
    ("proximal_tension", "T_MN", "unknown unit MN, force is in N, mN"),
    ("proximal_tension", "T (mV)", "unknown unit mV"),
    ("proximal_tension", "T[%]", "unknown unit %"),
    ("proximal_displacement", "q [dm]", "length is in m, mm"),
    ("proximal_displacement", "q_Mm", "unknown unit Mm, length is in m, mm"),
    ("time", "t [Ms]", "time is in s, sec, ms"),
]


@pytest.mark.parametrize(("channel", "name", "said"), UNKNOWN_UNITS)
def test_an_unknown_unit_is_refused_with_the_known_ones_and_the_option(path, channel, name, said):
    time, tension = pull(path)
    pull(path, **{name: tension if channel == "proximal_tension" else time})
    message = refusal(path, columns=Columns(**{channel: name}))
    assert said in message
    option = message.rpartition("--column ")[2].strip("'")
    assert option.startswith(f"{channel}={name}[")
    named = parse_column_options([option])  # as the message says
    assert len(read_table(path, named.names).time) == len(time)


@pytest.mark.parametrize(
    ("torque", "angle", "newton_metres", "radians"),
    [
        ("tau [N·mm]", "phi [°]", 1e-3, np.pi / 180),
        ("tau [N.mm]", "phi [degrees]", 1e-3, np.pi / 180),
        ("tau_N-mm", "phi (Degree)", 1e-3, np.pi / 180),
        ("tau N mm", "phi_degrees", 1e-3, np.pi / 180),
        ("tau (mN m)", "phi °", 1e-3, np.pi / 180),
        ("tau [N*m]", "phi [radians]", 1.0, 1.0),
        ("tau_NM", "phi_MRAD", 1.0, 1e-3),
    ],
)
def test_spellings_of_units_of_torque_and_angle(path, torque, angle, newton_metres, radians):
    _, tension = pull(path)
    pull(path, **{torque: tension, angle: tension})
    named = parse_column_options([f"proximal_torque={torque}", f"proximal_angle={angle}"])
    table = read_table(path, named.names, diagnosed=True, units=named.units)
    np.testing.assert_allclose(table.proximal_tension, newton_metres * tension)
    np.testing.assert_allclose(table.proximal_displacement, radians * tension)


def test_a_unit_of_the_option_may_be_spelt_with_a_dot(path):
    _, tension = pull(path)
    pull(path, tau=tension)
    named = parse_column_options(["proximal_torque=tau[N·mm]"])
    table = read_table(path, named.names, diagnosed=True, units=named.units)
    np.testing.assert_allclose(table.proximal_tension, 1e-3 * tension)


def test_degrees_of_a_named_angle_are_converted(path):
    _, tension = pull(path)
    pull(path, tau_Nmm=10.0 * tension, phi_deg=tension)
    named = parse_column_options(["proximal_torque=tau_Nmm", "proximal_angle=phi_deg"])
    table = read_table(path, named.names, diagnosed=True, units=named.units)
    np.testing.assert_allclose(table.proximal_tension, 0.01 * tension)
    np.testing.assert_allclose(table.proximal_displacement, np.radians(tension))


@pytest.mark.parametrize("period", [1.0, 0.5])
def test_milliseconds_and_sample_numbers_are_asked_about(path, period):
    _, tension = pull(path)
    write_table(path, {"time_s": period * np.arange(101), "proximal_tension_N": tension})
    said = refusal(path)
    assert "milliseconds, or sample numbers?" in said
    assert read_table(path, Columns("time_s[ms]")).time[1] == pytest.approx(1e-3 * period)
    assert read_table(path, Columns("time_s[s]")).time[1] == period
