"""Packed messages as numpy rows, and rows as columns of Rerun's components.

The archetypes' own `columns` convert and check each value by value; of many small blocks that
takes longer than their sending.
"""

from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import ArrayLike, NDArray
from rerun import AsComponents

from estimator.array_types import Array
from teleop.messages.messages import LAYOUT, MessageError
from teleop.messages.topics import Topic

APPLICATION = "teleop"
TIMELINE = "time"  # the stamp its sender gave a message
Strips = Sequence[Array] | Array  # lines of shape (points, 2 or 3), or as many points each stacked


class _Values:
    """Values as they are sent: a `rerun.ComponentBatchLike`."""

    def __init__(self, values: pa.Array) -> None:
        self._values = values

    def as_arrow_array(self) -> pa.Array:
        """Return the values."""
        return self._values


class Stamps(_Values):
    """The times of the rows of a block: a `rerun.TimeColumnLike`."""

    def __init__(self, stamps_ns: NDArray[np.int64]) -> None:
        # the stamps of a message are every so many bytes; a copy lies in one piece
        super().__init__(pa.array(np.array(stamps_ns, "datetime64[ns]")))

    def timeline_name(self) -> str:
        """Return the name of the timeline."""
        return TIMELINE


def build_columns(
    archetype: type, counts: ArrayLike | None = None, **fields: Any
) -> list[rr.ComponentColumn]:
    """Return the columns of some fields of an archetype.

    The `archetype` is such as `rerun.LineStrips2D`. `fields` are the values of all rows, one after
    another: numbers, texts, points (n, 2 or 3), or `Strips`, of which an empty sequence is of two
    dimensions; `counts` says how many of them are each row's, one if left out.
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


_CONVERSIONS = {
    "scalars": lambda values: pa.array(np.ascontiguousarray(values, np.float64)),
    "colors": lambda values: pa.array(np.asarray(values, np.uint32)),
    "labels": lambda values: pa.array(values, pa.string()),
    "radii": lambda values: pa.array(np.asarray(values, np.float32)),
    "positions": _to_point_array,
    "origins": _to_point_array,
    "vectors": _to_point_array,
    "strips": _to_strip_array,
}


# --- convert packed messages to numpy rows in batches, and downsample rows

AnyTopic = Topic[Any]
Rows = NDArray[np.void]  # one row a message, its fields those of the message's dtype


def decode(messages: Iterable[tuple[AnyTopic, bytes]]) -> dict[AnyTopic, Rows]:
    """Return the messages of each topic as one structured array, in their order.

    Only the layout is checked (the link has checked the rest); raises `MessageError`.
    """
    pieces: dict[AnyTopic, list[bytes]] = {}
    for topic, data in messages:
        pieces.setdefault(topic, []).append(data)
    batches = {}
    for topic, parts in pieces.items():
        schema = topic.message.schema
        foreign = any(len(part) != schema.size for part in parts)
        rows = (
            np.empty(0, schema.dtype) if foreign else np.frombuffer(b"".join(parts), schema.dtype)
        )
        if foreign or (rows["layout"] != LAYOUT).any():
            raise MessageError("layout", f"{topic.name}: made by another version of the messages")
        batches[topic] = rows
    return batches


def subsample_rows(rows: Rows, rate_hz: float) -> Rows:
    """Return about `rate_hz` rows a second: the last of each period, and always the newest.

    Periods are on a fixed grid of stamps, so no state is kept; at most one extra row per batch.
    """
    if len(rows) == 0:
        return rows
    period = rows["stamp_ns"] // round(1e9 / rate_hz)
    keep = np.append(period[1:] != period[:-1], True)
    kept: Rows = rows[keep]
    return kept


class Subsampler:
    """Downsamples rows; to lower rates while drawing would take too much processor time."""

    def __init__(self) -> None:
        self.stretch = 1.0  # factor of all periods

    def __call__(self, rows: Rows, rate_hz: float) -> Rows:
        """Return about `rate_hz` rows a second over the factor, as `subsample_rows`."""
        return subsample_rows(rows, rate_hz / self.stretch)


class RowDecimator:
    """Passes the first row of each period on, however the rows come in blocks.

    Periods are on a fixed grid of stamps.
    """

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = round(1e9 / rate_hz)
        self._newest = -1  # period of the newest row

    def __call__(self, rows: Rows) -> Rows:
        """Return at most `rate_hz` rows a second."""
        period = rows["stamp_ns"].astype(np.int64) // self._period_ns
        kept: Rows = rows[np.diff(period, prepend=self._newest) != 0]
        self._newest = int(period[-1]) if len(period) else self._newest
        return kept


def split_rows(rows: Rows, key: str) -> dict[int, Rows]:
    """Return the rows of each value of the integer field `key`."""
    return {int(value): rows[rows[key] == value] for value in np.unique(rows[key])}


# --- send columns of rows and static data to Rerun


class Sender:
    """A Rerun stream that takes blocks of rows, and remembers which entities have their style."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._styled: set[str] = set()
        self.newest_ns = 0  # [ns] the newest stamp sent

    def send_columns(self, path: str, rows: Rows, columns: Iterable[rr.ComponentColumn]) -> None:
        """Send `columns`, one row at the stamp of each of `rows`."""
        if len(rows) == 0:
            return
        self.send_columns_at(path, rows["stamp_ns"], columns)

    def send_columns_at(
        self, path: str, stamps_ns: NDArray[np.int64], columns: Iterable[rr.ComponentColumn]
    ) -> None:
        """Send `columns`, one row at each stamp [ns since the epoch]."""
        self._stream.send_columns(path, [Stamps(stamps_ns)], columns)
        self.newest_ns = max(self.newest_ns, int(stamps_ns.max(initial=0)))

    def send_static(self, path: str, archetype: AsComponents) -> None:
        """Send static data, replacing earlier ones."""
        self._stream.log(path, archetype, static=True)

    def send_once(self, path: str, archetype: AsComponents) -> None:
        """Send static data, if none were sent for this entity."""
        if path not in self._styled:
            self._styled.add(path)
            self.send_static(path, archetype)

    def send_words(
        self, path: str, kind: Any, places: ArrayLike, texts: Any, colour: Any, radius: float = 1e-6
    ) -> None:
        """Send texts at places, as static data; of their points nothing is seen without a radius.

        `kind` is `rerun.Points2D` or `rerun.Points3D`.
        """
        words = kind(places, labels=texts, colors=colour, radii=radius, show_labels=True)
        self.send_static(path, words)

    def has_style(self, path: str) -> bool:
        """Return whether static data were sent for this entity."""
        return path in self._styled

    def forget_styles(self) -> None:
        """Reset, so that static data are sent again."""
        self._styled.clear()
