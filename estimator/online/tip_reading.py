"""What a bench's load cell at the tip reads of a force: the scale on which estimates are scored.

A model of a bench may say that this cell has a wrong gain or zero. An estimate [N] is compared
with a reading as it is, so that errors with and without such an effect are in the same unit; the
estimate is therefore put through the cell's model. A table over the tension holds it, which the
loop can use sample by sample, and which is exact for a gain and a bias.
"""

from collections.abc import Sequence

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.effects.effect import DISTAL_TENSION, Effect, EffectContext, Values

TABLE_STEP = 1.0  # [N] from one entry of a table to the next
TABLE_SIZE = 1001  # entries, from 0 N on; beyond them the line goes on

IDENTITY_TABLE: Array = TABLE_STEP * np.arange(TABLE_SIZE, dtype=np.float64)
"""The table of a cell that reads the force."""


def build_reading_table(effects: Sequence[tuple[Effect, Values]]) -> Array:
    """Return what a cell with some effects reads at 0, `TABLE_STEP`, 2 `TABLE_STEP` ... [N], shape (COUNT,)."""
    none = np.zeros(TABLE_SIZE)
    context = EffectContext(none, "", none, none, {}, {}, none, 0.0)
    signals = {DISTAL_TENSION: IDENTITY_TABLE.copy()}
    for effect, values in effects:
        signals = effect.measure(signals, values, context)
    return np.ascontiguousarray(signals[DISTAL_TENSION], dtype=np.float64)


@jit_compile
def compute_reading(table: Array, tension: float) -> float:
    """Return what a cell reads of a tension [N]; NaN of NaN."""
    if not np.isfinite(tension):
        return tension
    i = min(max(int(tension / TABLE_STEP), 0), TABLE_SIZE - 2)
    slope = (table[i + 1] - table[i]) / TABLE_STEP
    return float(table[i] + slope * (tension - i * TABLE_STEP))
