"""Running error statistics of the loop's estimates against the bench sensors."""

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.online import force_error
from estimator.online.force_error import add_sample
from estimator.structs import StructArray


@jit_compile
def add_rows(
    all_sums: StructArray, tables: Array, layouts: StructArray, rows: StructArray, samples: int
) -> None:
    """Add all tendons of the first `samples` of a tick's rows."""
    for k in range(samples):
        row = rows[k]
        for i in range(layouts[0].tendons):
            e = row.tendons[i].estimate
            table = tables[min(i, len(tables) - 1)]  # one for all where no models are known
            add_sample(all_sums[0], table, e.distal_tension, e.low, e.high, row.bench_tension[i])


class Score(force_error.Score):
    """Running error of the distal tension [N] of all tendons against the bench sensors."""

    def add_rows(self, layouts: StructArray, rows: StructArray, samples: int) -> None:
        """Add all tendons of the first `samples` of a tick's rows."""
        add_rows(self._all_sums, self._tables, layouts, rows, samples)
