"""Ranges that the fields of a config state: what is refused, and how it is said."""

from dataclasses import dataclass
from math import inf, nan

import pytest

from teleop.config.ranges import RangedConfig, build_ranged_field


@dataclass(frozen=True, slots=True)
class Limits(RangedConfig):
    required: float = build_ranged_field(..., -1.0, 1.0, "m")
    above: float = build_ranged_field(1.0, 0.0, 2.0, "N", above=True)
    most: float = build_ranged_field(0.0, -inf, 0.0, "m")
    open_end: float = build_ranged_field(1.0, 0.0, inf, "s")
    may_be_infinite: float = build_ranged_field(1.0, 0.0, inf, may_be_infinite=True)
    infinite: float = build_ranged_field(inf, 0.0, inf, "N", above=True, bound=10.0)
    whole: int | None = build_ranged_field(None, 1, 20_000_000)
    each: tuple[float, ...] = build_ranged_field((), 0.0, 1.0)
    exceed_bounds: bool = False


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"required": 1.5}, "required: must be -1 to 1 m"),
        ({"required": nan}, "required: must be -1 to 1 m"),
        ({"required": -inf}, "required: must be -1 to 1 m"),
        ({"above": 0.0}, "above: must be above 0 and at most 2 N"),
        ({"most": 1e-9}, "most: must be at most 0 m"),
        ({"most": -inf}, "most: must be at most 0 m and finite"),
        ({"open_end": -1.0}, "open_end: must be at least 0 s"),
        ({"open_end": inf}, "open_end: must be at least 0 s and finite"),
        ({"may_be_infinite": nan}, "may_be_infinite: must be at least 0"),
        ({"infinite": 0.0}, "infinite: must be above 0 N"),
        ({"infinite": -inf}, "infinite: must be above 0 N"),
        (
            {"infinite": 10.5},
            "infinite: magnitude must be at most 10 N (docs/explanation/safety.md); ",
        ),
        ({"whole": 0}, "whole: must be 1 to 20000000"),
        ({"each": (0.5, 1.5)}, "each.1: must be 0 to 1"),
        ({"each": (nan,)}, "each.0: must be 0 to 1"),
    ],
)
def test_a_number_outside_its_range_is_refused_by_name(values, said):
    with pytest.raises(ValueError, match="must be") as refused:
        Limits(**({"required": 0.0} | values))
    assert str(refused.value).startswith(said)


def test_what_is_within_is_taken_with_the_ends_and_what_may_be_infinite():
    Limits(1.0, 2.0, 0.0, 0.0, inf, inf, 20_000_000, (0.0, 1.0))
    Limits(-1.0, 1e-300, -1e300, 1e300, 0.0, 10.0, None, ())
    Limits(0.0, infinite=11.0, exceed_bounds=True)
