"""LeRobot datasets, against the documented format and what the messages say one by one."""

import dataclasses
import json
import os
import subprocess
import textwrap
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet

from teleop.cli import commands
from teleop.data import recording_table
from teleop.messages.topics import STATE
from teleop.session.state_machine import State
from tests.root import ROOT
from tests.teleop.data.sessions import MS, expect_rows, record, session_messages

LEROBOT = Path(os.environ.get("LEROBOT_PYTHON", ROOT / ".cache/lerobot/bin/python"))
COUPLED = (State.ENGAGED, State.CLUTCHED)
STATES = [
    *[State.READY] * 60, *[State.ENGAGED] * 200, *[State.CLUTCHED] * 40, *[State.ENGAGED] * 60,
    *[State.HOLDING] * 30, *[State.ENGAGED] * 150, *[State.READY] * 10,
]  # fmt: skip
STEMS = {
    "action": "command_position_{}_m",
    "observation.state": "position_{}_m",
    "observation.force": "force_{}_N",
    "observation.force_low": "force_low_{}_N",
    "observation.force_high": "force_high_{}_N",
}
INDICES = ("frame_index", "episode_index", "index", "task_index")
TASK = "put the peg in"


def convert(out, *words):
    """Run the command; returns its exit code."""
    return commands.main(["recordings", "to-lerobot", *map(str, words), "--out", str(out)])


def cut_episodes(rows, is_inside, is_begin):
    """The episodes as lists of rows, by the rule in words."""
    episodes, previous = [], None
    for row in rows:
        if not is_inside(row) or np.isnan(row["command_age_s"]):
            previous = None
            continue
        gap_ns = row["stamp_ns"] - previous["stamp_ns"] if previous else -1
        if is_begin(row) or not 0 < gap_ns <= 500 * MS:
            episodes.append([])
        episodes[-1].append(row)
        previous = row
    return episodes


def expect_frames(rows, fps):
    """The newest row at or before each instant of an episode."""
    frames, first_ns = [], rows[0]["stamp_ns"]
    while (instant_ns := first_ns + len(frames) * 10**9 // fps) <= rows[-1]["stamp_ns"]:
        frames.append([row for row in rows if row["stamp_ns"] <= instant_ns][-1])
    return frames


def to_matrix(column):
    return np.array(column.to_pylist()).reshape(len(column), -1)


def assert_dataset(root, episodes, joints, fps):
    """The folder is a dataset of the documented format with the frames of `episodes`."""
    frames = [frame for episode in episodes for frame in episode]
    info = json.loads((root / "meta/info.json").read_text())
    assert {k: info[k] for k in ("codebase_version", "fps", "total_tasks", "splits")} == {
        "codebase_version": "v3.0",
        "fps": fps,
        "total_tasks": 1,
        "splits": {"train": f"0:{len(episodes)}"},
    }
    assert (info["total_episodes"], info["total_frames"]) == (len(episodes), len(frames))
    data = parquet.read_table(root / info["data_path"].format(chunk_index=0, file_index=0))
    assert data.column_names == list(info["features"]) == [*STEMS, "timestamp", *INDICES]
    for name, feature in info["features"].items():
        value = getattr(pa, feature["dtype"])()
        (length,) = feature["shape"]
        assert data.schema.field(name).type == (value if length == 1 else pa.list_(value, length))
    for name, stem in STEMS.items():
        names = [stem.format(j) for j in range(joints)]
        assert info["features"][name]["names"] == names
        wanted = np.array([[frame[column] for column in names] for frame in frames], np.float32)
        np.testing.assert_array_equal(to_matrix(data[name]).astype(np.float32), wanted)
    lengths = [len(episode) for episode in episodes]
    numbers = np.concatenate([np.arange(length) for length in lengths])
    np.testing.assert_array_equal(data["frame_index"], numbers)
    np.testing.assert_array_equal(data["timestamp"], (numbers / fps).astype(np.float32))
    np.testing.assert_array_equal(data["index"], np.arange(len(frames)))
    np.testing.assert_array_equal(data["episode_index"], np.repeat(range(len(lengths)), lengths))
    assert set(data["task_index"].to_pylist()) == {0}

    about = parquet.read_table(root / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    ends = np.cumsum(lengths).tolist()
    for k, row in enumerate(about):
        first = ends[k] - lengths[k]
        assert (row["episode_index"], row["tasks"], row["length"]) == (k, [TASK], lengths[k])
        assert (row["dataset_from_index"], row["dataset_to_index"]) == (first, ends[k])
        assert {row[f"{place}_index"] for place in ("data/chunk", "data/file")} == {0}
        part = data.slice(first, lengths[k])
        assert_statistics(lambda name, row=row: episode_statistics(row, name), part)
    stats = json.loads((root / "meta/stats.json").read_text())
    assert_statistics(stats.__getitem__, data)
    tasks = parquet.read_table(root / "meta/tasks.parquet")
    assert tasks.to_pylist() == [{"task_index": 0, "task": TASK}]
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]


def episode_statistics(row, name):
    prefix = f"stats/{name}/"
    return {key.removeprefix(prefix): row[key] for key in row if key.startswith(prefix)}


def assert_statistics(statistics_of, data):
    for name in data.column_names:
        values, found = to_matrix(data[name]).astype(np.float64), statistics_of(name)
        wanted = {
            "min": values.min(0),
            "max": values.max(0),
            "mean": values.mean(0),
            "std": values.std(0),
            "count": [len(values)],
        } | {f"q{q:02d}": np.percentile(values, q, axis=0) for q in (1, 10, 50, 90, 99)}
        assert set(found) == set(wanted)
        for key, value in wanted.items():
            np.testing.assert_allclose(found[key], value, rtol=1e-6, atol=1e-9, err_msg=name)


def is_coupled(row):
    return row["slave_state"] in [state.name.lower() for state in COUPLED]


@pytest.mark.parametrize(("joints", "part", "fps"), [(1, 100_000, 50), (3, 70, 200), (3, 1, 7)])
def test_an_episode_is_an_engagement_at_the_rate_of_the_dataset(
    tmp_path, monkeypatch, capsys, joints, part, fps
):
    monkeypatch.setattr(recording_table, "PART_MESSAGES", part)
    paths = [
        record(tmp_path, session_messages(joints, states, seed))
        for seed, states in enumerate((STATES, [State.CLUTCHED] * 300))
    ]
    out = tmp_path / "pegs"
    assert convert(out, *paths, "--fps", fps, "--task", TASK, "--repo-id", "lab/pegs") == 0
    episodes = [
        expect_frames(rows, fps)
        for path in paths
        for rows in cut_episodes(expect_rows(path), is_coupled, lambda _: False)
    ]
    assert len(episodes) == 3
    assert_dataset(out, episodes, joints, fps)
    said = capsys.readouterr().out
    assert f"3 episodes, {sum(map(len, episodes))} frames at {fps} Hz" in said
    assert "# lab/pegs" in (out / "README.md").read_text()


@pytest.mark.parametrize("part", [30, 100_000])
def test_an_episode_may_begin_at_marks_and_ends_at_a_gap(tmp_path, monkeypatch, part):
    monkeypatch.setattr(recording_table, "PART_MESSAGES", part)
    events = {20: "engaged: ok", 100: "mark: peg 1", 180: "off", 250: "mark: peg 2"}
    messages = session_messages(2, STATES, 3, events)
    late = [
        (topic, message, *(t + 600 * MS * (k > 900) for t in times))
        for k, (topic, message, *times) in enumerate(messages)
    ]
    path, out = record(tmp_path, late), tmp_path / "pegs"
    assert convert(out, path, "--fps", 100, "--task", TASK, "--marks", "mark:") == 0
    rows = expect_rows(path)
    mark = next(k for k, row in enumerate(rows) if "mark:" in row["event"])
    episodes = cut_episodes(rows[mark:], lambda _: True, lambda row: "mark:" in row["event"])
    assert len(episodes) == 3
    assert_dataset(out, [expect_frames(rows, 100) for rows in episodes], 2, 100)


def lose_force(messages, force, first, last):
    """Messages with another force in the states `first` to `last`."""
    numbers = iter(range(len(messages)))
    return [
        (topic, dataclasses.replace(message, force=(force,) * 8), *times)
        if topic is STATE and first <= next(numbers) < last
        else (topic, message, *times)
        for topic, message, *times in messages
    ]


@pytest.mark.parametrize("force", [np.nan, 1e300])
def test_an_episode_without_a_force_is_left_out_and_said(tmp_path, capsys, force):
    path = record(tmp_path, lose_force(session_messages(1, STATES), force, 100, 200))
    assert convert(tmp_path / "pegs", path, "--task", TASK) == 0
    captured = capsys.readouterr()
    assert "1 episodes" in captured.out
    assert f"left out: {path}: the episode at 0.06" in captured.err
    assert "no finite value of force_0_N in frame" in captured.err


def test_frames_without_a_state_of_their_own_repeat_the_one_before_and_are_counted(
    tmp_path, capsys
):
    messages = session_messages(1, [State.ENGAGED] * 400)
    del messages[300:700]
    path, out = record(tmp_path, messages), tmp_path / "pegs"
    assert convert(out, path, "--fps", 100, "--task", TASK) == 0
    (rows,) = cut_episodes(expect_rows(path), is_coupled, lambda _: False)
    frames = expect_frames(rows, 100)
    assert_dataset(out, [frames], 1, 100)
    held = sum(
        (rows[0]["stamp_ns"] + k * 10 * MS - frame["stamp_ns"]) > 10 * MS
        for k, frame in enumerate(frames)
    )
    assert held > 10
    assert f"{held} frames repeat the one before" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("joints", "states", "words", "complaint"),
    [
        ((1,), [State.READY] * 50, [], "the slave was never engaged"),
        ((1,), STATES, ["--marks", "peg"], "no event contains 'peg'"),
        ((1, 2), STATES, [], "has 2 joints, the recordings before it 1"),
        ((1,), STATES, ["--fps", "0"], "--fps 0: allowed are 1 to 1000"),
        ((1,), STATES, ["--repo-id", "a/b/c"], "--repo-id a/b/c: must be a name"),
        ((1,), STATES, ["--task", " "], "--task: must be text"),
    ],
)
def test_what_cannot_be_a_dataset_is_one_line_and_no_folder(
    tmp_path, refused, joints, states, words, complaint
):
    paths = [record(tmp_path / "run", session_messages(n, states)) for n in joints]
    out = tmp_path / "out" / "pegs"
    out.parent.mkdir()
    words = ["recordings", "to-lerobot", *paths, "--task", TASK, *words, "--out", out]
    assert complaint in refused(*words)
    assert not list(out.parent.iterdir())


READER = textwrap.dedent(
    """
    import json, sys
    import torch
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    root, name = sys.argv[1:]
    dataset = LeRobotDataset(name, root=root, delta_timestamps={"action": [0.0, 0.02]})
    frames = []
    for frame in torch.utils.data.DataLoader(dataset, batch_size=None):
        frames.append({k: v.tolist() for k, v in frame.items() if isinstance(v, torch.Tensor)})
    stats = {k: v["mean"].tolist() for k, v in dataset.meta.stats.items()}
    task = dataset[0]["task"]
    print(json.dumps([dataset.num_episodes, dataset.fps, task, stats, frames]))
    """
)


@pytest.mark.slow
@pytest.mark.skipif(not LEROBOT.exists(), reason="make test-lerobot installs LeRobot")
@pytest.mark.parametrize("joints", [1, 3])
def test_lerobot_reads_the_dataset(tmp_path, joints):
    path, out = record(tmp_path, session_messages(joints, STATES)), tmp_path / "pegs"
    assert convert(out, path, "--task", TASK, "--repo-id", "lab/pegs") == 0
    ran = subprocess.run(
        [LEROBOT, "-c", READER, str(out), "lab/pegs"],
        env={
            **os.environ,
            "HF_HOME": str(tmp_path / "hf"),
            "HF_HUB_OFFLINE": "1",
            "PYTHONPATH": "",
        },
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    episodes, fps, task, means, frames = json.loads(ran.stdout.splitlines()[-1])
    data = parquet.read_table(out / "data/chunk-000/file-000.parquet")
    assert (episodes, fps, task, len(frames)) == (2, 50, TASK, data.num_rows)
    for name in data.column_names:
        values = to_matrix(data[name])
        np.testing.assert_allclose(means[name], values.mean(0), rtol=1e-6, atol=1e-9)
        for k, frame in enumerate(frames):
            read = np.array(frame[name]).reshape(-1, values.shape[1])
            np.testing.assert_allclose(read[0], values[k], rtol=1e-6)
            if name == "action" and not frame["action_is_pad"][1]:
                np.testing.assert_allclose(read[1], values[k + 1], rtol=1e-6)
