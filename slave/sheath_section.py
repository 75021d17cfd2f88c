"""Config of a section of a sheath, of the plant as of the model of the estimator."""

import math
from dataclasses import dataclass, field

from teleop.config.loading import MAY_BE_INFINITE


@dataclass(frozen=True, slots=True)
class SectionConfig:
    """A stretch of sheath of constant bend radius."""

    length: float  # [m] of the stretch
    # [m] of the bend; .inf = straight
    radius: float = field(default=math.inf, metadata=MAY_BE_INFINITE)

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        if not 0.0 < self.length <= 100.0:
            raise ValueError("length: must be above 0 and at most 100 m")
        if not self.radius > 0.0:
            raise ValueError("radius: must be above 0 m")
