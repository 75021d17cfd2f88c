"""A recording as a table: one row a state of the slave, with what the master had sent by then.

States, commands and hands have no clock in common but the recorder's, so they are joined in the
order in which it received them: a row has the newest command and hand received before the state,
and their age. A recording is read in parts, in memory that does not grow with its length.
"""

import importlib
import math
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from teleop.config.suggestions import suggest_spelling
from teleop.data.file_formats import read_columns
from teleop.data.large_csv import PROGRESS_DELAY_S
from teleop.errors import UsageError
from teleop.messages.messages import MAX_JOINTS, decode_text
from teleop.messages.topics import COMMAND, EVENT, HAND, STATE, format_role
from teleop.recording.reader import (
    ROWS_MAX,
    TopicRows,
    build_missing_topic_error,
    list_doubts,
    read_row_parts,
)
from teleop.recording.scan import RecordingError, Scan
from teleop.runtime.process import print_warning
from teleop.runtime.status_line import Progress
from teleop.session.state_machine import Reason, State

PART_MESSAGES = 100_000  # converted at once: 100 MB with eight joints

_FIELDS = {
    STATE.name: (
        "log_time_ns", "stamp_ns", "state", "reason", "joints", "position", "force", "force_low",
        "force_high", "status", "sample_age_ns",
    ),
    COMMAND.name: ("log_time_ns", "state", "reason", "position", "velocity"),
    HAND.name: ("log_time_ns", "position", "velocity", "force"),
    EVENT.name: ("log_time_ns", "role", "state", "reason", "text"),
}  # fmt: skip
_JOINT_COLUMNS = (  # stem and unit of the name, topic, field
    ("position", "_m", STATE.name, "position"),
    ("force", "_N", STATE.name, "force"),
    ("force_low", "_N", STATE.name, "force_low"),
    ("force_high", "_N", STATE.name, "force_high"),
    ("status", "", STATE.name, "status"),
    ("command_position", "_m", COMMAND.name, "position"),
    ("command_velocity", "_m_per_s", COMMAND.name, "velocity"),
    ("hand_position", "_m", HAND.name, "position"),
    ("hand_velocity", "_m_per_s", HAND.name, "velocity"),
    ("hand_force", "_N", HAND.name, "force"),
)
_CODE_MAX = 255  # of states and reasons; beyond it none is known


@dataclass(frozen=True, slots=True)
class RecordedEvent:
    """An event of a session."""

    time_s: float  # when the recorder received it, since it received the first state
    role: str  # of the sender, such as "slave"
    state: str  # of the sender, such as "engaged"
    reason: str  # behind the state, such as "none"
    text: str


@dataclass(frozen=True, eq=False)
class RecordingTable(Mapping[str, NDArray[Any]]):
    """A table as a mapping of column name to array, shape (rows,); `read_recording` reads one.

    Attributes
    ----------
    arrow : pyarrow.Table
        The columns.
    events : tuple of RecordedEvent
        All events in the range of time that was read, also those that no row follows.
    doubts : tuple of str
        What the file lacks, one line each.
    """

    path: Path
    arrow: Any
    events: tuple[RecordedEvent, ...] = ()
    doubts: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return a column: numbers, or an object array of text, None where there is none."""
        if name not in self.arrow.column_names:
            raise KeyError(name)
        import pyarrow as pa

        column = self.arrow[name]
        if not pa.types.is_dictionary(column.type):
            return np.asarray(column.to_numpy())
        column = column.combine_chunks()  # Arrow's own conversion takes null for a name
        texts = np.array([*column.dictionary.to_pylist(), None], dtype=object)
        return np.asarray(texts[column.indices.fill_null(-1).to_numpy()])

    def __iter__(self) -> Iterator[str]:
        return iter(self.arrow.column_names)

    def __len__(self) -> int:
        return int(self.arrow.num_columns)

    def __repr__(self) -> str:
        return f"RecordingTable({self.path}: {self.arrow.num_rows} rows of {', '.join(self)})"

    def to_numpy(self) -> dict[str, NDArray[Any]]:
        """Return all columns as arrays."""
        return dict(self)

    def to_pandas(self) -> Any:
        """Return a `pandas.DataFrame`, states and reasons as categories."""
        _import_library("pandas")
        return self.arrow.to_pandas()

    def to_polars(self) -> Any:
        """Return a `polars.DataFrame`, states and reasons as categories."""
        return _import_library("polars").from_arrow(self.arrow)


def read_recording(
    path: Path | str,
    columns: Collection[str] | None = None,
    *,
    begin_s: float | None = None,
    end_s: float | None = None,
    rate_hz: float | None = None,
) -> RecordingTable:
    """Read a recording, or another file of measured data, into a table.

    What a recording lacks is told in lines on standard error, and in `RecordingTable.doubts`.

    Parameters
    ----------
    path : Path or str
        .mcap of the project, also one that is truncated; .csv, .csv.gz or .parquet; or a bag.
    columns : collection of str, optional
        The columns to read; all by default.
    begin_s, end_s : float, optional
        [s] since the first row: rows from `begin_s` on, before `end_s`.
    rate_hz : float, optional
        [Hz] of a recording, the first row in each period of it; all by default.

    Raises
    ------
    UsageError
        The file cannot be read, is too large, or lacks a column; or no row is in the range.
    """
    path = Path(path)
    if path.suffix.lower() != ".mcap":
        return _read_measured_data(path, columns, begin_s, end_s)
    import pyarrow as pa

    batches = RecordingBatches(path, columns, begin_s=begin_s, end_s=end_s, rate_hz=rate_hz)
    parts, size = [], 0
    for batch in batches:
        parts.append(batch)
        size += batch.nbytes
        if size > ROWS_MAX:
            raise UsageError(
                f"{path}: has more than {ROWS_MAX >> 30} GB of values; read fewer columns, a part "
                "(begin_s, end_s) or fewer rows (rate_hz)"
            )
    doubts = batches.list_doubts()
    for line in doubts:
        print_warning(line)
    return RecordingTable(path, pa.Table.from_batches(parts), batches.list_events(), tuple(doubts))


@dataclass
class RecordingBatches:
    """The rows of a recording, in parts; iterate over it once. Parameters as of `read_recording`.

    Iterating yields `pyarrow.RecordBatch` objects of one schema, each with at least a row; it
    raises `UsageError` as `read_recording` does. A bar shows the progress, on a terminal.

    Attributes
    ----------
    rows : int
        Number of rows so far.
    joints : int
        Number of joints in use; -1 before the first row.
    """

    path: Path
    columns: Collection[str] | None = None
    begin_s: float | None = field(default=None, kw_only=True)
    end_s: float | None = field(default=None, kw_only=True)
    rate_hz: float | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        self.rows, self.joints = 0, -1
        self._scan, self._is_whole = Scan(self.path), False
        self._range_s = _check_range(self.begin_s, self.end_s)
        if self.rate_hz is not None and not 1e-3 <= self.rate_hz <= 1e6:
            raise UsageError(f"a rate of {self.rate_hz:g} Hz: allowed are 0.001 to 1000000 Hz")
        self._period_ns = 0 if self.rate_hz is None else round(1e9 / self.rate_hz)
        self._period = -1  # number of that of the last row
        self._start_ns = self._start_log_ns = 0  # of the first row: sent, received
        self._latest: dict[str, NDArray[np.void]] = {}  # topic -> its newest message
        self._events: list[tuple[int, str, str, str, str]] = []  # receipt [ns], as RecordedEvent
        self._pending: list[tuple[int, int, str]] = []  # place, receipt [ns], text: of the next row

    def __iter__(self) -> Iterator[Any]:
        begin_s, progress = time.monotonic(), Progress()
        try:
            for part in read_row_parts(self._scan, _FIELDS, PART_MESSAGES):
                batch = self._convert(part)
                if batch is not None and batch.num_rows:
                    self.rows += batch.num_rows
                    yield batch
                if self._is_past_end():
                    break
                if time.monotonic() - begin_s > PROGRESS_DELAY_S:
                    progress(f"reading {self.path}", self._scan.share)
            else:
                self._is_whole = True
        finally:
            progress.end()
        if self.joints < 0:
            raise build_missing_topic_error(self._scan, STATE.name)
        if not self.rows:
            last_s = self._to_seconds(self._latest[STATE.name])[0]
            raise UsageError(f"{self.path}: no row in this range; its last is at {last_s:.3f} s")

    def list_events(self) -> tuple[RecordedEvent, ...]:
        """Return the events in the range, of what was read so far."""
        events = (RecordedEvent(self._to_event_time(log), *rest) for log, *rest in self._events)
        return tuple(event for event in events if self._is_in_range(event.time_s))

    def list_doubts(self) -> list[str]:
        """Return what the file lacks, one line each, once it has been read."""
        return list_doubts(self._scan, f"{self.rows} rows" if self._is_whole else None)

    def _to_seconds(self, states: NDArray[np.void]) -> NDArray[np.float64]:
        seconds: NDArray[np.float64] = (states["stamp_ns"] - self._start_ns) / 1e9
        return seconds

    def _to_event_time(self, log_ns: int) -> float:
        return (log_ns - self._start_log_ns) / 1e9

    def _is_in_range(self, time_s: Any) -> Any:
        return (time_s >= self._range_s[0]) & (time_s < self._range_s[1])

    def _is_past_end(self) -> bool:
        newest = self._latest.get(STATE.name)
        return newest is not None and bool(self._to_seconds(newest)[0] >= self._range_s[1])

    def _convert(self, part: Mapping[str, TopicRows]) -> Any:
        """Return the rows of a part of the recording, None if it has no states."""
        for place, row in zip(*part.get(EVENT.name, ((), ())), strict=True):
            role, text = format_role(int(row["role"])), decode_text(tuple(row["text"].tolist()))
            names = _name_code(State, row["state"]), _name_code(Reason, row["reason"])
            log_ns = int(row["log_time_ns"])
            self._events.append((log_ns, role, *names, text))
            self._pending.append((int(place), log_ns, f"{role}: {text}"))
        batch = None
        if STATE.name in part:
            states = part[STATE.name].rows
            if self.joints < 0:
                self._begin(states[0])
            kept = self._choose_rows(states["stamp_ns"])
            self._check_joints(states[kept])
            batch = self._build_batch(states[kept], part[STATE.name].places[kept], part)
        self._latest |= {topic: rows[-1:].copy() for topic, (_, rows) in part.items()}
        return batch

    def _begin(self, state: Any) -> None:
        self.joints = int(state["joints"])
        self._start_ns, self._start_log_ns = int(state["stamp_ns"]), int(state["log_time_ns"])
        if not 1 <= self.joints <= MAX_JOINTS:
            raise RecordingError(
                f"{self.path}: its first state has {self.joints} joints, 1 to {MAX_JOINTS} are "
                "possible: it is no recording of a session"
            )

    def _check_joints(self, states: NDArray[np.void]) -> None:
        if (other := states["joints"] != self.joints).any():
            row = states[int(other.argmax())]
            raise RecordingError(
                f"{self.path}: has {self.joints} joints at first, and {row['joints']} from "
                f"{self._to_seconds(row):.3f} s on; read it up to there"
            )

    def _choose_rows(self, stamp_ns: NDArray[np.int64]) -> NDArray[np.intp]:
        """Return the indices of the states that become rows."""
        since_ns = stamp_ns - self._start_ns
        kept = np.flatnonzero(self._is_in_range(since_ns / 1e9))
        if self._period_ns and len(kept):
            periods = since_ns[kept] // self._period_ns
            is_first = np.diff(periods, prepend=self._period) != 0
            self._period = int(periods[-1])
            kept = kept[is_first]
        return kept

    def _build_batch(
        self, states: NDArray[np.void], places: NDArray[np.int64], part: Mapping[str, TopicRows]
    ) -> Any:
        import pyarrow as pa

        joined = {
            topic: self._join(states, places, topic, part.get(topic))
            for topic in (COMMAND.name, HAND.name)
        }
        joined[STATE.name] = _Joined(states, np.zeros(len(states), dtype=np.bool_), states)
        command = joined[COMMAND.name]
        builders: dict[str, Callable[[], Any]] = {
            "time_s": partial(self._to_seconds, states),
            "time_unix_ns": partial(np.array, states["stamp_ns"]),
            "slave_state": partial(joined[STATE.name].name_values, "state", State),
            "slave_reason": partial(joined[STATE.name].name_values, "reason", Reason),
            "master_state": partial(command.name_values, "state", State),
            "master_reason": partial(command.name_values, "reason", Reason),
            "event": partial(self._attach_events, places),
            "sample_age_s": lambda: states["sample_age_ns"] / 1e9,
            "command_age_s": command.compute_age,
            "hand_age_s": joined[HAND.name].compute_age,
        }
        builders |= {
            f"{stem}_{joint}{unit}": partial(joined[topic].take, name, joint)
            for stem, unit, topic, name in _JOINT_COLUMNS
            for joint in range(self.joints)
        }
        names = _select_columns(self.path, list(builders), self.columns)
        if "event" not in names:
            self._pending.clear()
        return pa.RecordBatch.from_pydict({name: builders[name]() for name in names})

    def _join(
        self,
        states: NDArray[np.void],
        places: NDArray[np.int64],
        topic: str,
        taken: TopicRows | None,
    ) -> "_Joined":
        """Return the newest message of a topic at each state."""
        earlier = self._latest.get(topic)
        rows = [] if earlier is None else [earlier]
        before = np.zeros(len(states), dtype=np.intp)
        if taken is not None:
            rows.append(taken.rows)
            before = np.searchsorted(taken.places, places)
        if not rows:
            return _Joined(np.zeros(0, dtype=np.void), np.ones(len(states), dtype=np.bool_), states)
        index = before - (earlier is None)
        return _Joined(np.concatenate(rows)[np.maximum(index, 0)], index < 0, states)

    def _attach_events(self, places: NDArray[np.int64]) -> Any:
        """Return the events of each row: those in the range since the row before."""
        import pyarrow as pa

        texts = [""] * len(places)
        pending, self._pending = self._pending, []
        for place, log_ns, text in pending:
            row = int(np.searchsorted(places, place))
            if row == len(places):
                self._pending.append((place, log_ns, text))
            elif self._is_in_range(self._to_event_time(log_ns)):
                texts[row] += f"; {text}" if texts[row] else text
        return pa.array(texts, pa.string())


@dataclass(frozen=True, slots=True)
class _Joined:
    """Messages of a topic, one a row."""

    rows: NDArray[np.void]  # of the topic; of any content where `is_missing`, empty if all are
    is_missing: NDArray[np.bool_]  # before the first
    states: NDArray[np.void]

    def take(self, name: str, joint: int) -> NDArray[Any]:
        """Return an element of a field; NaN where missing."""
        if not len(self.rows):
            return np.full(len(self.states), np.nan)
        values: NDArray[Any] = np.array(self.rows[name][:, joint])
        return np.where(self.is_missing, np.nan, values) if self.is_missing.any() else values

    def compute_age(self) -> NDArray[np.float64]:
        """Return how long before the state the recorder received the message [s]."""
        if not len(self.rows):
            return np.full(len(self.states), np.nan)
        age = (self.states["log_time_ns"] - self.rows["log_time_ns"]) / 1e9
        return np.where(self.is_missing, np.nan, age)

    def name_values(self, name: str, kind: type[IntEnum]) -> Any:
        """Return states or reasons as a dictionary array of their names; null where missing."""
        import pyarrow as pa

        names, indices = _list_names(kind)
        codes = self.rows[name] if len(self.rows) else np.zeros(len(self.states), dtype=np.uint32)
        chosen = pa.array(indices[np.minimum(codes, _CODE_MAX)], mask=self.is_missing)
        return pa.DictionaryArray.from_arrays(chosen, names)


def _name_code(kind: type[IntEnum], code: Any) -> str:
    return kind(int(code)).name.lower()


@cache
def _list_names(kind: type[IntEnum]) -> tuple[list[str], NDArray[np.int8]]:
    """Return all names of states or reasons, and the index of the name of each code."""
    names = [member.name.lower() for member in kind]
    indices = [names.index(_name_code(kind, code)) for code in range(_CODE_MAX + 1)]
    return names, np.array(indices, dtype=np.int8)


def _check_range(begin_s: float | None, end_s: float | None) -> tuple[float, float]:
    begin, end = -math.inf if begin_s is None else begin_s, math.inf if end_s is None else end_s
    if not begin < end:  # or not a number
        raise UsageError(f"from {begin:g} to {end:g} s: the end must come after the beginning")
    return begin, end


def _select_columns(
    path: Path, present: Collection[str], wanted: Collection[str] | None
) -> Collection[str]:
    """Return the columns that are wanted; `UsageError` if one is not present."""
    for name in wanted or ():
        if name not in present:
            hint = suggest_spelling(name, present) or f" (it has {', '.join(present)})"
            raise UsageError(f"{path}: no column {name!r}{hint}")
    return present if wanted is None else wanted


def _read_measured_data(
    path: Path, columns: Collection[str] | None, begin_s: float | None, end_s: float | None
) -> RecordingTable:
    """Read a table, or a bag; its text is of strings."""
    import pyarrow as pa

    raw = read_columns(path)
    if raw.breaks:
        place = raw.place(raw.breaks[0])
        raise UsageError(
            f"{path}: {place}: a second run begins here (the names come again); "
            "teleop.data.read_runs reads each by itself"
        )
    read = raw.columns
    kept: slice | NDArray[np.bool_] = slice(None)
    if begin_s is not None or end_s is not None:
        _select_columns(path, read, ["time_s"])
        begin, end = _check_range(begin_s, end_s)
        since = np.asarray(read["time_s"], dtype=np.float64)
        since = since - since[:1]
        kept = (since >= begin) & (since < end)
    arrays = {name: read[name][kept] for name in _select_columns(path, read, columns)}
    return RecordingTable(
        path, pa.table({k: pa.array(v, from_pandas=False) for k, v in arrays.items()})
    )


def _import_library(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name:
            raise
        raise UsageError(f"{name} is not installed: pip install {name}") from error
