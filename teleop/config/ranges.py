"""Fields of a config that state their range, checked as a section is built.

A gate's limit protects only while it is near what it protects. So it has a bound besides
(docs/explanation/safety.md), which a slip of the decimal point or a wrong unit exceeds;
`exceed_bounds: true` beside it says that it is no slip.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

MAY_BE_INFINITE: Mapping[str, object] = {"may_be_infinite": True}
"""Metadata of a field whose number may be infinite, though its default is not."""
MOTION_MAX = 1e3  # [m], [m/s] beyond any hand or tip: a fault; NaN fails a comparison with it too


class Range(NamedTuple):
    """Numbers that a key of a config may have, in the metadata of its field as `range`."""

    low: float
    high: float
    unit: str = ""
    above: bool = False  # whether `low` itself is excluded
    bound: float = math.inf  # of its magnitude, unless `exceed_bounds`

    def __str__(self) -> str:
        low, high = (f"{end}" if isinstance(end, int) else f"{end:g}" for end in self[:2])
        if math.isinf(self.low):
            text = f"at most {high}"
        elif math.isinf(self.high):
            text = f"{'above' if self.above else 'at least'} {low}"
        else:
            text = f"above {low} and at most {high}" if self.above else f"{low} to {high}"
        return f"{text} {self.unit}".rstrip()


def build_ranged_field(
    default: Any,
    low: float,
    high: float,
    unit: str = "",
    *,
    above: bool = False,
    bound: float = math.inf,
    may_be_infinite: bool = False,
) -> Any:
    """Return a dataclass field of a number from `low`, or `above` it, to `high`.

    An infinite bound is none; the number itself may be infinite only if its default is, or with
    `may_be_infinite`. Of a tuple each entry must be in the range; None is allowed. Beyond `bound`,
    in magnitude, the section must say `exceed_bounds`. With `...` there is no default.
    """
    metadata: dict[str, Any] = {"range": Range(low, high, unit, above, bound)}
    if may_be_infinite or (default is not None and default in (math.inf, -math.inf)):
        metadata |= MAY_BE_INFINITE
    if default is ...:
        return dataclasses.field(metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def check_ranges(config: Any) -> None:
    """Raise `ValueError` for a field outside its range."""
    for item in dataclasses.fields(config):
        if "range" not in item.metadata:
            continue
        allowed, value = item.metadata["range"], getattr(config, item.name)
        entries = enumerate(value) if isinstance(value, tuple) else [("", value)]
        for place, number in entries:
            if number is None:
                continue
            name = f"{item.name}.{place}".rstrip(".")
            is_finite = math.isfinite(number) or "may_be_infinite" in item.metadata
            is_inside = allowed.low <= number <= allowed.high
            if not (is_inside and is_finite) or (allowed.above and number == allowed.low):
                finite = " and finite" * (is_inside and not is_finite)
                raise ValueError(f"{name}: must be {allowed}{finite}")
            if allowed.bound < abs(number) < math.inf and not config.exceed_bounds:
                raise ValueError(
                    f"{name}: magnitude must be at most {allowed.bound:g} {allowed.unit} "
                    "(docs/explanation/safety.md); check the unit, or set exceed_bounds: true "
                    "beside it"
                )


class RangedConfig:
    """A section of which nothing but its ranges is to be checked."""

    __slots__ = ()

    def __post_init__(self) -> None:
        check_ranges(self)


class BoundedConfig(Protocol):
    """Limits that may exceed their bounds."""

    @property
    def exceed_bounds(self) -> bool:
        """Whether they may."""


def build_bounds_warnings(section: str, config: BoundedConfig) -> list[str]:
    """Return a warning if the limits of a section may exceed their bounds."""
    text = (
        f"WARNING: {section}.exceed_bounds: its limits may be beyond those of "
        "docs/explanation/safety.md"
    )
    return [text] * config.exceed_bounds
