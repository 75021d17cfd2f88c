"""What the sensors at the housing make of the truth."""

from dataclasses import dataclass
from math import pi


@dataclass(frozen=True, slots=True)
class LoadCellConfig:
    """A load cell: noise, then a converter of finite resolution and range."""

    noise: float = 0.010  # [N] standard deviation, white
    resolution: float = 0.002  # [N] of the converter; 0 = infinitely fine
    range: float = 100.0  # [N] the reading stops here, at both ends

    def __post_init__(self) -> None:
        """Refuse what no load cell is like."""
        for name in ("noise", "resolution"):
            if not 0.0 <= getattr(self, name) <= 10.0:
                raise ValueError(f"{name}: must be 0 to 10 N")
        if not 0.0 < self.range <= 1e5:
            raise ValueError("range: must be above 0 and at most 100 000 N")

    def read(self, tension: float, normal: float) -> float:
        """Return the reading [N] of `tension` [N], given a standard normal deviate."""
        reading = rounded(tension + self.noise * normal, self.resolution)
        return min(max(reading, -self.range), self.range)


@dataclass(frozen=True, slots=True)
class EncoderConfig:
    """An encoder on the motor's pulley; 67 000 lines as in Phee et al. 2009."""

    lines: int = 67_000  # per revolution of the pulley, gear included; 0 = infinitely fine
    pulley_radius: float = 0.010  # [m]

    def __post_init__(self) -> None:
        """Refuse what no encoder is like."""
        if not 0 <= self.lines <= 10**9:
            raise ValueError("lines: must be 0 to 1 000 000 000")
        if not 0.0 < self.pulley_radius <= 1.0:
            raise ValueError("pulley_radius: must be above 0 and at most 1 m")

    @property
    def resolution(self) -> float:
        """Tendon travel of one line [m]."""
        return 2.0 * pi * self.pulley_radius / self.lines if self.lines else 0.0

    def read(self, displacement: float) -> float:
        """Return the reading [m] of `displacement` [m]."""
        return rounded(displacement, self.resolution)


def rounded(value: float, resolution: float) -> float:
    """Return `value` at the nearest multiple of `resolution`; as it is where that is 0."""
    return round(value / resolution) * resolution if resolution > 0.0 else value
