"""Units of a record, and how its numbers go along with them."""

import pytest

from estimator.diagnosis.record import BenchScale, parse_dimension
from estimator.units import LINEAR, ROTARY

R = 0.01
SCALE = BenchScale(R, 1.0 / R)  # N to N m and m to rad on a pulley of radius R


@pytest.mark.parametrize(
    ("unit", "name", "size"),
    [
        ("N", "N m", R),
        ("m", "rad", 1 / R),
        ("m/N", "rad/(N m)", R**-2),
        ("N/m", "N m/rad", R**2),
        ("N s/m", "N m s/rad", R**2),
        ("kg", "kg m^2", R**2),
        ("N/min", "N m/min", R),
        ("1/N", "1/(N m)", 1 / R),
        ("m/10 N", "rad/(10 N m)", R**-2),
        ("s", "s", 1.0),
        ("", "", 1.0),
        ("of K", "of K", 1.0),
    ],
)
def test_numbers_of_a_model_have_the_records_units(unit, name, size):
    assert ROTARY.name_unit(unit) == name
    assert SCALE.size(unit) == pytest.approx(size)
    assert SCALE.inverse.size(unit) == pytest.approx(1.0 / size)
    assert LINEAR.name_unit(unit) == unit


def test_units_of_the_catalogue_are_all_known():
    from estimator.effects import CATALOGUE

    for unit in {p.unit for effect in CATALOGUE for p in effect.parameters}:
        assert ("m/" not in f"{unit}/") or ROTARY.name_unit(unit) != unit
        assert (parse_dimension(unit) != (0, 0)) == (ROTARY.name_unit(unit) != unit)
