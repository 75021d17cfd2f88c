"""How far the estimate was from the bench sensor, kept while the loop runs."""

import math
from dataclasses import dataclass
from typing import Any

from slave.loop import Row

PULLED = 200.0  # times the noise: of a smaller full scale a percentage tells of the noise alone


@dataclass(slots=True)
class Score:
    """Running error of the distal tension [N] against a bench sensor; empty where there is none.

    Parameters
    ----------
    noise : float
        Standard deviation [N] of the housing's load cells, 0 if it is not known.
    """

    noise: float = 0.0
    samples: int = 0
    peak: float = 0.0  # [N] largest measured distal tension: the full scale
    inside: int = 0  # samples inside the certified interval
    _square: float = 0.0
    _absolute: float = 0.0
    _worst: float = 0.0

    def add(self, estimate: float, low: float, high: float, measured: float) -> None:
        """Take one sample in; a missing bench value (NaN) or estimate does not count."""
        error = estimate - measured
        if not math.isfinite(error):
            return
        self.samples += 1
        self.peak = max(self.peak, measured)
        self.inside += low <= measured <= high
        self._square += error * error
        self._absolute += abs(error)
        self._worst = max(self._worst, abs(error))

    def add_row(self, row: Row) -> None:
        """Take in all tendons of one sample."""
        if row.sample.bench_distal_tension is not None:
            measured = row.sample.bench_distal_tension.tolist()
            for e, m in zip(row.estimates, measured, strict=True):
                self.add(e.distal_tension, e.low, e.high, m)

    def summary(self) -> dict[str, Any] | None:
        """Return RMSE, mean and maximum error [N] and in % of full scale, or None without bench."""
        if not self.samples:
            return None
        rmse = math.sqrt(self._square / self.samples)
        mean = self._absolute / self.samples
        percent = 100.0 / self.peak if self.peak > 0.0 else math.nan
        return {
            "samples": self.samples,
            "full_scale_N": self.peak,
            "pulled": self.peak >= PULLED * self.noise,
            "rmse_N": rmse,
            "mean_N": mean,
            "max_N": self._worst,
            "rmse_percent": rmse * percent,
            "mean_percent": mean * percent,
            "max_percent": self._worst * percent,
            "inside_interval": self.inside / self.samples,
        }
