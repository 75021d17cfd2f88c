"""Column names tell the units of a record, and contradictions are refused with the right name."""

import numpy as np
import pytest

from estimator.units import FORCE, ROTARY
from teleop.data.mapping_file import parse_column_options
from teleop.data.measured_table import read_table, write_table
from teleop.errors import UsageError
from tests.teleop.data.records import refusal

ROTARY_NAMES = ("proximal_torque_Nm", "proximal_angle_rad", "distal_torque_Nm")


def written(path, *names):
    time = np.arange(5) / 10
    swing = np.array([0.2, 0.1, -0.3, -0.2, 0.0])
    write_table(path, {"time_s": time} | dict.fromkeys(names, swing))
    return path


def test_torque_and_angle_are_read_with_either_sign(path):
    table = read_table(written(path, *ROTARY_NAMES), diagnosed=True)
    assert table.units == ROTARY
    assert table.proximal_tension.min() == -0.3
    assert table.distal_displacement is None
    assert list(table.columns()) == ["time_s", *ROTARY_NAMES]


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
        (["proximal_torque_Nm", "proximal_angle_m"], ["not in radians", "'proximal_angle_rad'"]),
        (["proximal_torque_Nm", "distal_tension_N"], ["as a whole", "'distal_tension_N'"]),
        (["proximal_tension_N", "distal_force_N"], ["both forces"]),
    ],
)
def test_a_name_that_contradicts_its_unit_is_refused_with_the_right_one(path, names, parts):
    message = refusal(written(path, *names), diagnosed=True)
    for part in parts:
        assert part in message


def test_degrees_and_newton_millimetres_are_noticed(path):
    time = np.arange(5) / 10
    write_table(path, {"time_s": time, "proximal_torque_Nm": 5e3 * time})
    assert "[Nmm]" in refusal(path, diagnosed=True)
    columns = {"time_s": time, "proximal_torque_Nm": time, "proximal_angle_rad": 400.0 * time}
    write_table(path, columns)
    assert "proximal_angle_rad[deg]" in refusal(path, diagnosed=True)


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
