"""Where the numbers of a model are in the row that a fit searches."""

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.diagnosis.dataset import Dataset, Model
from estimator.diagnosis.model import OWN_LOADS, compute_record_bounds, find_record_zeros

Mask = NDArray[np.bool_]


class ParameterLayout:
    """The numbers of a model in a row, each counted in its step.

    Readings of encoders count from the first one: a fit ends at a step that is small beside its
    numbers, and begins with one that is large beside them.
    """

    def __init__(self, dataset: Dataset, model: Model) -> None:
        base = dataset.base
        effects = [effect for effect, _ in model.effects]
        self.base, self.effects, self.records = base, effects, len(model.own)
        self.names = [p.name for p in base.shared]
        self.parameters = list(base.shared)
        span = max(float(np.ptp(record.drive)) for record in dataset.records)
        for effect, values in model.effects:
            self.names += [f"{effect.name}.{p.name}" for p in effect.parameters]
            self.parameters += effect.within(effect.parameters, span, values)
        self.common = len(self.parameters)  # those of the dataset come first
        for k, record in enumerate(dataset.records):
            self.names += [f"{p.name} ({k + 1})" for p in base.own]
            self.parameters += [
                p._replace(low=low, high=high)
                for p, (low, high) in zip(
                    base.own, compute_record_bounds(record, base), strict=True
                )
            ]
        zeros = [zero for record in dataset.records for zero in find_record_zeros(record, base)]
        self._zeros = np.array([0.0] * self.common + zeros)
        self._steps = [p.step for p in self.parameters]
        compliance = base.compliance(model.shared)
        if compliance is not None:  # known to a share of itself, whatever the tendon
            for i, p in enumerate(self.parameters):
                if p.unit == "m/N":
                    self._steps[i] = 0.03 * max(compliance, 1e-7)

    @property
    def smooth(self) -> Mask:
        """Which numbers a slope leads to."""
        return np.array([not p.jumps for p in self.parameters])

    @property
    def shape(self) -> Mask:
        """Which numbers only shape an effect, and have a slope."""
        return np.array([p.neutral is None and not p.jumps for p in self.parameters])

    @property
    def when(self) -> Mask:
        """Which numbers say when something happened, and how long it took."""
        mask = np.zeros(len(self.parameters), dtype=np.bool_)
        at = len(self.base.shared)
        for effect in self.effects:
            if any(p.jumps for p in effect.parameters):
                for i, p in enumerate(effect.parameters, start=at):
                    mask[i] = p.neutral is None
            at += len(effect.parameters)
        return mask

    @property
    def loads(self) -> list[int]:
        """Places of what the tips of single records pull at."""
        known = {p.name for p in OWN_LOADS[self.base.loads]}
        own = [p.name in known for p in self.base.own] * self.records
        return [self.common + k for k, is_load in enumerate(own) if is_load]

    @property
    def own(self) -> Mask:
        """Which numbers are of single records."""
        return np.arange(len(self.parameters)) >= self.common

    def step(self, i: int) -> float:
        """Return the step of a number."""
        return self._steps[i]

    def bounds(self) -> tuple[Array, Array]:
        """Return the least and the largest of each number."""
        return (
            self._counted(np.array([p.low for p in self.parameters])),
            self._counted(np.array([p.high for p in self.parameters])),
        )

    def values(self, model: Model) -> list[float]:
        """Return the numbers of a model, in a row."""
        of_effects = [value for _, values in model.effects for value in values]
        return [*model.shared, *of_effects, *(value for own in model.own for value in own)]

    def pack(self, model: Model) -> Array:
        """Return them in their steps."""
        return self._counted(np.array(self.values(model)))

    def unpack(self, x: Array) -> Model:
        """Return the model of a row."""
        values = (np.asarray(x) * np.array(self._steps) + self._zeros).tolist()
        at = len(self.base.shared)
        shared = tuple(values[:at])
        effects = []
        for effect in self.effects:
            count = len(effect.parameters)
            effects.append((effect, tuple(values[at : at + count])))
            at += count
        size = len(self.base.own)
        own = tuple(tuple(values[at + k * size : at + (k + 1) * size]) for k in range(self.records))
        return Model(shared, own, tuple(effects))

    def _counted(self, values: Array) -> Array:
        return np.asarray((values - self._zeros) / np.array(self._steps))
