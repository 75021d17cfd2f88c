"""An estimator of your own: the capstan equation by the direction of the motor, nothing else.

slave: {estimator: {type: mylab-capstan, dead_band: 2.0e-5}}
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimator.online.online import TendonModel
from slave.extensions import EstimatorExtension, HousingSample, TipEstimate


@dataclass(frozen=True)
class CapstanConfig(EstimatorExtension):
    """Keys of `slave.estimator` in the config."""

    dead_band: float = 2e-5  # [m] of motor travel without a direction

    def open(self, models: Sequence[TendonModel]) -> "Capstan":
        return Capstan(self.dead_band, models)


class Capstan:
    """Between the two sliding directions, where the law has memory, it takes the last one."""

    def __init__(self, dead_band: float, models: Sequence[TendonModel]) -> None:
        self._dead_band = dead_band
        self._gain = np.exp([model.sheath.K for model in models])
        self._length = np.array([m.sheath.length / m.sheath.axial_stiffness for m in models])
        self._turned = np.zeros(len(models))  # [m] where the motors turned last, or passed since
        self._sign = np.ones(len(models))

    def step(self, sample: HousingSample) -> TipEstimate:
        if sample.displacement is not None:
            travel = sample.displacement - self._turned
            moved = np.abs(travel) > self._dead_band
            self._sign[moved] = np.sign(travel[moved])
            self._turned[moved] = sample.displacement[moved]
        tension = np.maximum(sample.tension, 0.0)
        low, high = tension / self._gain, tension * self._gain
        tip = np.where(self._sign > 0.0, low, high)
        return TipEstimate(tip, low, high, 0.5 * (tension + tip) * self._length)
