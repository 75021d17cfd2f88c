"""Columns of Rerun's components, made from numpy arrays.

The archetypes' own `columns` convert and check each value by value; of many small blocks that
takes longer than their sending.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import ArrayLike, NDArray

from estimator.array_types import Array

TIMELINE = "time"  # the stamp its sender gave a message
Strips = Sequence[Array] | Array  # lines of shape (points, 2 or 3), or as many points each stacked


class Stamps:
    """The times of the rows of a block: a `rerun.TimeColumnLike`."""

    def __init__(self, stamps_ns: NDArray[np.int64]) -> None:
        # the stamps of a message are every so many bytes; a copy lies in one piece
        self._times = pa.array(np.array(stamps_ns, "datetime64[ns]"))

    def timeline_name(self) -> str:
        """Return the name of the timeline."""
        return TIMELINE

    def as_arrow_array(self) -> pa.Array:
        """Return the times."""
        return self._times


class _Values:
    """Values as they are sent: a `rerun.ComponentBatchLike`."""

    def __init__(self, values: pa.Array) -> None:
        self._values = values

    def as_arrow_array(self) -> pa.Array:
        """Return the values."""
        return self._values


def build_columns(
    archetype: type, counts: ArrayLike | None = None, **fields: Any
) -> list[rr.ComponentColumn]:
    """Return the columns of some fields of an archetype.

    Parameters
    ----------
    archetype : type
        Such as `rerun.LineStrips2D`.
    counts : array_like, optional
        How many of the values are each row's; one if left out.
    **fields
        The values of all rows, one after another: numbers, texts, points (n, 2 or 3), or `Strips`,
        of which an empty sequence is of two dimensions.
    """
    made = []
    for name, values in fields.items():
        arrow = _CONVERSIONS[name](values)
        offsets = np.arange(len(arrow) + 1, dtype=np.int32)
        if counts is not None:
            offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        made.append(
            rr.ComponentColumn(_find_descriptor(archetype, name), _Values(arrow), offsets=offsets)
        )
    return made


@cache
def _find_descriptor(archetype: Any, name: str) -> rr.ComponentDescriptor:
    descriptor: rr.ComponentDescriptor = getattr(archetype, f"descriptor_{name}")()
    return descriptor


@cache
def _build_point_type(dimensions: int) -> pa.DataType:
    return pa.list_(pa.field("item", pa.float32(), nullable=False), dimensions)


def _to_point_array(points: Array) -> pa.Array:
    flat = np.ascontiguousarray(points, np.float32).ravel()
    return pa.FixedSizeListArray.from_arrays(flat, type=_build_point_type(points.shape[1]))


def _to_strip_array(strips: Strips) -> pa.Array:
    if isinstance(strips, np.ndarray):
        lines, each, dimensions = strips.shape
        points, offsets = strips.reshape(-1, dimensions), np.arange(lines + 1) * each
    else:
        points = np.concatenate(strips) if strips else np.empty((0, 2))
        offsets = np.concatenate([[0], np.cumsum([len(strip) for strip in strips])])
    kind = pa.list_(pa.field("item", _build_point_type(points.shape[1]), nullable=False))
    return pa.ListArray.from_arrays(offsets.astype(np.int32), _to_point_array(points), type=kind)


def _to_float32_array(values: Array) -> pa.Array:
    return pa.array(np.asarray(values, np.float32))


_CONVERSIONS = {
    "scalars": lambda values: pa.array(np.ascontiguousarray(values, np.float64)),
    "colors": lambda values: pa.array(np.asarray(values, np.uint32)),
    "labels": lambda values: pa.array(values, pa.string()),
    "radii": _to_float32_array,
    "positions": _to_point_array,
    "origins": _to_point_array,
    "vectors": _to_point_array,
    "strips": _to_strip_array,
}
