"""Recordings as a LeRobotDataset v3.0, for imitation learning.

The format is that of github.com/huggingface/lerobot, `docs/source/lerobot-dataset-v3.mdx` and
`src/lerobot/datasets`. A frame has the newest values at or before its instant; instants are
1 / fps apart and begin with the first state of an episode.
"""

import itertools
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from teleop.data.recording_table import RecordingBatches
from teleop.errors import UsageError
from teleop.runtime.output_file import make_new_folder
from teleop.session.state_machine import State

VERSION = "v3.0"
FEATURES = MappingProxyType(
    {
        "action": ("command_position", "m"),
        "observation.state": ("position", "m"),
        "observation.force": ("force", "N"),
        "observation.force_low": ("force_low", "N"),
        "observation.force_high": ("force_high", "N"),
    }
)
"""Feature, an element for each joint -> stem and unit of the columns in a recording's table."""

_INDICES = ("frame_index", "episode_index", "index", "task_index")
_QUANTILES = (0.01, 0.10, 0.50, 0.90, 0.99)
_COUPLED = (State.ENGAGED.name.lower(), State.CLUTCHED.name.lower())
_GAP_MAX_NS = 500_000_000  # between two states of an episode; a session holds after 0.1 s
_DATA_FILE = "{folder}/chunk-{{chunk_index:03d}}/file-{{file_index:03d}}.parquet"
_CARD = """\
---
tags: [LeRobot, teleoperation]
task_categories: [robotics]
configs:
- config_name: default
  data_files: data/*/*.parquet
---

# {repo_id}

{episodes} episodes, {frames} frames at {fps} Hz of "{task}", recorded with tendon-teleop
(LeRobotDataset {version}).

| feature | of each joint |
|---|---|
| action | commanded travel of the tip [m] |
| observation.state | estimated travel of the tip [m] |
| observation.force | estimated force at the tip [N] |
| observation.force_low, observation.force_high | ends of its certified interval [N] |

| episode | recording | begins at [s] |
|---|---|---|
"""


@dataclass(frozen=True, slots=True)
class Episode:
    """The frames of an episode."""

    path: Path  # of the recording
    begin_s: float  # in it
    joints: int
    values: NDArray[np.float32]  # shape (frames, features * joints), in the order of FEATURES
    held: int  # frames whose values are more than a frame old: states are missing

    @property
    def fault(self) -> str:
        """Why it cannot be used, one line; "" = it can."""
        place = f"{self.path}: the episode at {self.begin_s:.3f} s"
        if len(self.values) < 2:
            return f"{place} has a single frame"
        frame, element = np.unravel_index(np.argmin(np.isfinite(self.values)), self.values.shape)
        if not np.isfinite(self.values[frame, element]):
            name = list_names(self.joints)[element]
            return f"{place} has no finite value of {name} in frame {frame}"
        return ""


@dataclass(slots=True)
class DatasetSummary:
    """What was written."""

    episodes: int = 0
    frames: int = 0
    joints: int = 0
    held: int = 0  # frames whose values are more than a frame old
    left_out: tuple[str, ...] = ()  # episodes, one line each
    doubts: tuple[str, ...] = ()  # what the recordings lack, one line each


def list_names(joints: int, feature: str = "") -> list[str]:
    """Return the names of the elements of a feature, or of all."""
    chosen = [FEATURES[feature]] if feature else FEATURES.values()
    return [f"{stem}_{joint}_{unit}" for stem, unit in chosen for joint in range(joints)]


class _Resampler:
    """Collects the newest values at each instant of an episode."""

    def __init__(self, begin_ns: int, fps: int) -> None:
        self.begin_ns, self.held = begin_ns, 0
        self._fps, self._frames = fps, 0
        self._parts: list[NDArray[np.float32]] = []
        self._last_ns = np.zeros(0, dtype=np.int64)
        self._last_values: NDArray[np.float32] | None = None

    def add(self, stamp_ns: NDArray[np.int64], values: NDArray[np.float32]) -> None:
        """Add states that follow; their values have the shape (states, elements)."""
        if self._last_values is not None:
            stamp_ns = np.concatenate([self._last_ns, stamp_ns])
            values = np.concatenate([self._last_values, values])
        frames = int(stamp_ns[-1] - self.begin_ns) * self._fps // 10**9 + 1
        instants = self.begin_ns + np.arange(self._frames, frames) * 10**9 // self._fps
        newest = np.searchsorted(stamp_ns, instants, side="right") - 1
        self.held += int(np.sum((instants - stamp_ns[newest]) * self._fps > 10**9))
        self._parts.append(values[newest])
        self._frames = frames
        self._last_ns, self._last_values = stamp_ns[-1:], values[-1:]

    def finish(self) -> NDArray[np.float32]:
        """Return the values of all frames."""
        return np.concatenate(self._parts)


def read_episodes(batches: RecordingBatches, fps: int, mark: str = "") -> Iterator[Episode]:
    """Yield the episodes of a recording, its `batches` of all columns, with `fps` frames a second.

    An episode lasts while the slave is engaged, clutch included; or, with `mark`, from each event
    whose text contains it until the next, or the end. It begins once there is a command, and ends
    too where no state was recorded for half a second or the slave's clock was set back.
    """
    resampler: _Resampler | None = None
    start_ns = last_ns = 0
    was_inside = is_marked = False

    def finish(resampler: _Resampler) -> Episode:
        begin_s = (resampler.begin_ns - start_ns) / 1e9
        return Episode(batches.path, begin_s, batches.joints, resampler.finish(), resampler.held)

    for batch in batches:
        stamp_ns = batch["time_unix_ns"].to_numpy()
        start_ns = start_ns or int(stamp_ns[0])
        is_inside = np.isfinite(batch["command_age_s"].to_numpy())
        begins = np.zeros(len(stamp_ns), dtype=np.bool_)
        if mark:
            begins = np.array([mark in text for text in batch["event"].to_pylist()])
            marked = np.logical_or.accumulate(begins) | is_marked
            is_inside, is_marked = is_inside & marked, bool(marked[-1])
        else:
            is_inside &= np.isin(batch["slave_state"].to_numpy(zero_copy_only=False), _COUPLED)
        gap_ns = np.diff(stamp_ns, prepend=last_ns)
        begins |= (gap_ns <= 0) | (gap_ns > _GAP_MAX_NS)
        begins |= np.diff(is_inside, prepend=was_inside)
        last_ns, was_inside = int(stamp_ns[-1]), bool(is_inside[-1])
        columns = [batch[name].to_numpy() for name in list_names(batches.joints)]
        with np.errstate(over="ignore"):  # what becomes infinite leaves its episode out
            values = np.stack(columns, axis=1, dtype=np.float32, casting="same_kind")
        edges = np.flatnonzero(begins[1:]) + 1
        for first, end in itertools.pairwise([0, *edges.tolist(), len(stamp_ns)]):
            if begins[first]:
                if resampler is not None:
                    yield finish(resampler)
                inside = is_inside[first]
                resampler = _Resampler(int(stamp_ns[first]), fps) if inside else None
            if resampler is not None:
                resampler.add(stamp_ns[first:end], values[first:end])
    if resampler is not None:
        yield finish(resampler)


def write_dataset(
    folder: Path, paths: Sequence[Path], repo_id: str, fps: int, task: str, mark: str = ""
) -> DatasetSummary:
    """Write the episodes of recordings as a dataset; the folder appears when all is written.

    The card has the name `repo_id`; `fps` [Hz] are the frames a second, `task` is what is done in
    words, `mark` as of `read_episodes`. `UsageError` if a recording cannot be read; they differ in
    their joints; there is no episode; or the folder exists or cannot be written.
    """
    summary, rows, sources = DatasetSummary(), list[dict[str, Any]](), list[str]()
    with make_new_folder(folder) as root:
        data = root / _DATA_FILE.format(folder="data").format(chunk_index=0, file_index=0)
        (root / "meta").mkdir()
        data.parent.mkdir(parents=True)
        writer: Any = None
        try:
            for path in paths:
                batches = RecordingBatches(path)
                for episode in read_episodes(batches, fps, mark):
                    if episode.fault:
                        summary.left_out += (episode.fault,)
                        continue
                    _check_joints(summary, episode)
                    table = _build_frames(episode, len(rows), summary.frames, fps)
                    if writer is None:
                        from pyarrow import parquet

                        writer = parquet.ParquetWriter(data, table.schema)
                    writer.write_table(table, row_group_size=len(episode.values))
                    rows.append(_describe_episode(table, len(rows), summary.frames, task))
                    sources.append(f"| {len(rows) - 1} | {path.name} | {episode.begin_s:.3f} |\n")
                    summary.frames += len(episode.values)
                    summary.held += episode.held
                summary.doubts += tuple(batches.list_doubts())
        finally:
            if writer is not None:
                writer.close()
        summary.episodes = len(rows)
        if not rows:
            cause = f"no event contains {mark!r}" if mark else "the slave was never engaged"
            cause = summary.left_out[0] if summary.left_out else cause
            raise UsageError(f"no episode in {', '.join(map(str, paths))}: {cause}")
        _write_metadata(root, data, rows, summary, fps, task)
        card = _CARD.format(
            repo_id=repo_id, fps=fps, task=task, version=VERSION, frames=summary.frames,
            episodes=summary.episodes,
        )  # fmt: skip
        (root / "README.md").write_text(card + "".join(sources), encoding="utf-8")
    return summary


def _check_joints(summary: DatasetSummary, episode: Episode) -> None:
    if summary.joints and episode.joints != summary.joints:
        raise UsageError(
            f"{episode.path}: has {episode.joints} joints, the recordings before it "
            f"{summary.joints}; write a dataset of each"
        )
    summary.joints = episode.joints


def _build_frames(episode: Episode, number: int, first: int, fps: int) -> Any:
    """Return the frames of an episode as an Arrow table; a feature of one element is a scalar."""
    import pyarrow as pa

    frames, joints = len(episode.values), episode.joints
    columns: dict[str, Any] = {}
    for k, name in enumerate(FEATURES):
        values = pa.array(episode.values[:, k * joints : (k + 1) * joints].ravel())
        columns[name] = pa.FixedSizeListArray.from_arrays(values, joints) if joints > 1 else values
    columns["timestamp"] = (np.arange(frames) / fps).astype(np.float32)
    columns["frame_index"] = np.arange(frames)
    columns["episode_index"] = np.full(frames, number)
    columns["index"] = np.arange(first, first + frames)
    columns["task_index"] = np.zeros(frames, dtype=np.int64)
    return pa.table(columns)


def _to_matrix(column: Any) -> NDArray[Any]:
    """Return a column of a dataset as an array, shape (frames, elements)."""
    import pyarrow as pa

    rows = len(column)
    is_list = pa.types.is_fixed_size_list(column.type)
    values: NDArray[Any] = (column.combine_chunks().flatten() if is_list else column).to_numpy()
    return values.reshape(rows, -1)


def compute_statistics(values: NDArray[Any]) -> dict[str, list[Any]]:
    """Return the statistics by which LeRobot normalises a feature, shape (frames, elements)."""
    numbers = values.astype(np.float64)
    quantiles = np.quantile(numbers, _QUANTILES, axis=0)
    return {
        "min": values.min(axis=0).tolist(),
        "max": values.max(axis=0).tolist(),
        "mean": numbers.mean(axis=0).tolist(),
        "std": numbers.std(axis=0).tolist(),
        "count": [len(values)],
    } | {
        f"q{round(100 * q):02d}": row.tolist() for q, row in zip(_QUANTILES, quantiles, strict=True)
    }


def _describe_episode(table: Any, number: int, first: int, task: str) -> dict[str, Any]:
    """Return the row of an episode in meta/episodes."""
    return {
        "episode_index": number,
        "tasks": [task],
        "length": table.num_rows,
        "data/chunk_index": 0,
        "data/file_index": 0,
        "dataset_from_index": first,
        "dataset_to_index": first + table.num_rows,
        **{
            f"stats/{name}/{key}": value
            for name in table.column_names
            for key, value in compute_statistics(_to_matrix(table[name])).items()
        },
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
    }


def _write_metadata(
    root: Path, data: Path, rows: list[dict[str, Any]], summary: DatasetSummary, fps: int, task: str
) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    names = (*FEATURES, "timestamp", *_INDICES)
    features: dict[str, Any] = {
        name: {
            "dtype": "int64" if name in _INDICES else "float32",
            "shape": [summary.joints if name in FEATURES else 1],
            "names": list_names(summary.joints, name) if name in FEATURES else None,
        }
        for name in names
    }
    info = {
        "codebase_version": VERSION,
        "robot_type": "tendon_teleop",
        "total_episodes": summary.episodes,
        "total_frames": summary.frames,
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{summary.episodes}"},
        "data_path": _DATA_FILE.format(folder="data"),
        "video_path": None,
        "features": features,
    }
    statistics = {
        name: compute_statistics(_to_matrix(parquet.read_table(data, columns=[name])[name]))
        for name in names
    }
    for name, tree in (("info", info), ("stats", statistics)):
        text = json.dumps(tree, indent=4, ensure_ascii=False)
        (root / "meta" / f"{name}.json").write_text(text, encoding="utf-8")
    tasks = pa.table({"task_index": pa.array([0]), "task": pa.array([task])})
    parquet.write_table(
        tasks.replace_schema_metadata({"pandas": json.dumps(_PANDAS)}), root / "meta/tasks.parquet"
    )
    episodes = root / _DATA_FILE.format(folder="meta/episodes").format(chunk_index=0, file_index=0)
    episodes.parent.mkdir(parents=True)
    parquet.write_table(pa.Table.from_pylist(rows), episodes)


_PANDAS = {  # LeRobot reads tasks with pandas, indexed by the task
    "index_columns": ["task"],
    "column_indexes": [],
    "columns": [
        {"name": "task_index", "pandas_type": "int64", "numpy_type": "int64", "metadata": None},
        {"name": "task", "pandas_type": "unicode", "numpy_type": "object", "metadata": None},
    ],
    "pandas_version": "2.2.0",
}
