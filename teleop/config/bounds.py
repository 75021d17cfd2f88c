"""Upper bounds of the limits in a config: what no rig or hand of this kind should be given.

A limit protects only while it is near what it protects. So a gate's limits have bounds of their own
(docs/explanation/safety.md), which a slip of the decimal point or a wrong unit exceeds;
`exceed_bounds: true` beside them says that it is no slip.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple, Protocol

MOTION_MAX = 1e3  # [m], [m/s] beyond any hand or tip: a fault; NaN fails a comparison with it too


class Bound(NamedTuple):
    """The bound of one limit: its magnitude may be `most` [unit], or infinite if that is none."""

    name: str
    most: float
    unit: str


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


def check_bounds(config: object, bounds: Sequence[Bound], exceed: bool) -> None:
    """Raise `ValueError` for a limit beyond its bound, unless `exceed`."""
    for name, most, unit in bounds:
        value = abs(getattr(config, name))
        if most < value < math.inf and not exceed:
            raise ValueError(
                f"{name}: must be at most {most:g} {unit} (docs/explanation/safety.md); check the "
                "unit, or set exceed_bounds: true beside it"
            )
