"""Config of a section of a sheath, of the plant as of the model of the estimator."""

import math
from dataclasses import dataclass

from teleop.config.ranges import RangedConfig, build_ranged_field


@dataclass(frozen=True, slots=True)
class SectionConfig(RangedConfig):
    """A stretch of sheath of constant bend radius."""

    length: float = build_ranged_field(..., 0.0, 100.0, "m", above=True)  # of the stretch
    # of the bend; .inf = straight
    radius: float = build_ranged_field(math.inf, 0.0, math.inf, "m", above=True)
