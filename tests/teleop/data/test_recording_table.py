"""Tables of recordings, against what their messages say one by one."""

import dataclasses
import re
import sys

import numpy as np
import pytest

from teleop import read_recording
from teleop.cli import commands
from teleop.data import recording_table
from teleop.errors import UsageError
from teleop.messages.messages import SlaveState
from teleop.messages.topics import HAND, STATE
from teleop.session.state_machine import State
from tests.teleop.data.sessions import MS, START_NS, expect_rows, record, session_messages

STATES = [State(k // 40 % 7) for k in range(400)]
EVENTS = {0: "begins", 3: "engaged: ok", 200: "set: scale, 2", 201: 'a "mark"', 399: "off"}


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    messages = session_messages(3, STATES, events=EVENTS)
    return record(tmp_path_factory.mktemp("run"), messages)


def assert_rows(table, expected):
    hidden = {"stamp_ns", "log_ns", "events"}
    assert set(table) == set(expected[0]) - hidden
    for name, column in table.items():
        wanted = [row[name] for row in expected]
        np.testing.assert_array_equal(column, np.array(wanted, dtype=column.dtype), name)


@pytest.mark.parametrize("part", [1, 70, 100_000])
@pytest.mark.parametrize("joints", [1, 8])
def test_a_row_has_what_was_received_before_its_state(tmp_path, monkeypatch, part, joints):
    monkeypatch.setattr(recording_table, "PART_MESSAGES", part)
    events = {k: f"mark {k}" for k in range(200)}  # the last message of a part, too
    path = record(tmp_path, session_messages(joints, STATES[:200], joints, events))
    expected = expect_rows(path)
    assert np.isnan(expected[0]["command_age_s"])
    assert sum(";" in row["event"] for row in expected) > 5
    assert_rows(read_recording(path), expected)


@pytest.mark.parametrize("part", [70, 100_000])
def test_range_and_rate_choose_rows_and_lose_no_event(recording, monkeypatch, part):
    monkeypatch.setattr(recording_table, "PART_MESSAGES", part)
    table = read_recording(recording, begin_s=0.1, end_s=0.35, rate_hz=100.0)
    expected, texts, period = [], [], -1
    rows = expect_rows(recording)
    for row in rows:
        times = [(log_ns - rows[0]["log_ns"]) / 1e9 for log_ns, _ in row["events"]]
        texts += [
            text
            for time_s, (_, text) in zip(times, row["events"], strict=True)
            if 0.1 <= time_s < 0.35
        ]
        number = (row["stamp_ns"] - rows[0]["stamp_ns"]) // (10 * MS)
        if 0.1 <= row["time_s"] < 0.35 and number != period:
            expected.append(row | {"event": "; ".join(texts)})
            texts, period = [], number
    assert len(expected) == 25
    assert table["event"].tolist().count('master: set: scale, 2; master: a "mark"') == 1
    assert_rows(table, expected)
    assert [event.text for event in table.events] == ["set: scale, 2", 'a "mark"']


def test_events_are_a_table_of_their_own(recording):
    table = read_recording(recording)
    assert [event.text for event in table.events] == list(EVENTS.values())
    assert {(event.role, event.state, event.reason) for event in table.events} == {
        ("master", "engaged", "none")
    }
    first_ns = expect_rows(recording)[0]["log_ns"]
    np.testing.assert_allclose(
        [event.time_s for event in table.events],
        [(START_NS + k * MS + 1 - first_ns) * 1e-9 for k in EVENTS],
        atol=1e-12,
    )


def test_of_a_truncated_recording_the_rows_before_the_end_are_read(recording, tmp_path, capsys):
    path = tmp_path / "cut.mcap"
    content = recording.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    table = read_recording(path)
    (doubt,) = table.doubts
    assert f"{path}: is truncated" in doubt
    assert doubt in capsys.readouterr().err
    expected = expect_rows(recording)[: table.arrow.num_rows]
    assert 20 < len(expected) < 390
    assert_rows(table, expected)


@pytest.mark.parametrize(
    "words", [["to-table", "--out", "{}.csv"], ["to-lerobot", "--task", "x", "--out", "{}.set"]]
)
def test_every_conversion_says_what_a_recording_lacks(recording, tmp_path, capsys, words):
    path = tmp_path / "cut.mcap"
    path.write_bytes(recording.read_bytes()[:-2000])
    assert commands.main(["recordings", *[word.format(path) for word in words], str(path)]) == 0
    lines = capsys.readouterr().err.splitlines()
    (line,) = (line for line in lines if not line.startswith("reading "))  # of a slow machine
    assert line.startswith(f"WARNING: {path}: is truncated")


def test_columns_are_chosen_by_name(recording):
    whole, table = read_recording(recording), read_recording(recording, ["force_0_N", "time_s"])
    assert list(table) == ["force_0_N", "time_s"]
    np.testing.assert_array_equal(table["force_0_N"], whole["force_0_N"])
    with pytest.raises(UsageError, match=r"no column 'force_0'; did you mean 'force_0_N'\?"):
        read_recording(recording, ["force_0"])


def test_data_frames_have_the_same_values(recording):
    pandas, polars = pytest.importorskip("pandas"), pytest.importorskip("polars")
    table = read_recording(recording)
    frame, other = table.to_pandas(), table.to_polars()
    assert isinstance(frame.slave_state.dtype, pandas.CategoricalDtype)
    assert isinstance(other["slave_state"].dtype, polars.Categorical | polars.Enum)
    assert list(frame) == other.columns == list(table.to_numpy())
    for name, column in table.to_numpy().items():
        if column.dtype == object:
            assert other[name].to_list() == column.tolist()
            assert frame[name].astype(object).where(frame[name].notna(), None).tolist() == (
                column.tolist()
            )
        else:
            np.testing.assert_array_equal(frame[name].to_numpy(), column)
            np.testing.assert_array_equal(other[name].to_numpy(), column)


@pytest.mark.parametrize("name", ["pandas", "polars"])
def test_a_missing_library_is_one_line_with_its_remedy(recording, monkeypatch, name):
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(UsageError, match=f"^{name} is not installed: pip install {name}$"):
        getattr(read_recording(recording), f"to_{name}")()


@pytest.mark.parametrize("suffix", [".parquet", ".csv", ".csv.gz"])
def test_a_written_table_says_the_same(recording, tmp_path, monkeypatch, capsys, suffix):
    monkeypatch.setattr(recording_table, "PART_MESSAGES", 300)
    out = tmp_path / f"run{suffix}"
    words = ["recordings", "to-table", str(recording), "--out", str(out)]
    assert commands.main([*words, "--from", "0.1", "--to", "0.3"]) == 0
    assert capsys.readouterr().out.startswith(f"wrote {out}: ")
    table, back = read_recording(recording, begin_s=0.1, end_s=0.3), read_recording(out)
    assert list(back) == list(table)
    for name, column in table.items():
        if column.dtype == object:
            assert [text or "" for text in back[name]] == [text or "" for text in column]
        else:
            np.testing.assert_array_equal(back[name], column.astype(np.float64), name)
    assert [path.name for path in tmp_path.iterdir()] == [out.name]


def test_measured_data_are_a_table_too(tmp_path):
    path = tmp_path / "bench.csv"
    path.write_text("time_s,proximal_tension_N,note\n5,1,a\n6,2,\n7,3,c\n")
    table = read_recording(path, begin_s=1.0, end_s=2.0)
    assert {name: column.tolist() for name, column in table.items()} == {
        "time_s": [6.0],
        "proximal_tension_N": [2.0],
        "note": [""],
    }


def change_joints(messages):
    return [
        (topic, dataclasses.replace(message, joints=2), *times)
        if topic is STATE and k > len(messages) // 2
        else (topic, message, *times)
        for k, (topic, message, *times) in enumerate(messages)
    ]


@pytest.mark.parametrize(
    ("change", "options", "complaint"),
    [
        (lambda messages: messages, ["--from", "3"], "no row in this range; its last is at 0.399"),
        (lambda messages: messages, ["--from", "3", "--to", "2"], "the end must come after"),
        (lambda messages: messages, ["--rate", "0"], "a rate of 0 Hz"),
        (change_joints, [], "has 3 joints at first, and 2 from 0."),
        (lambda m: [one for one in m if one[0] is HAND], [], "no messages of topic 'state'"),
        (lambda m: [(STATE, SlaveState(joints=9), *m[0][2:])], [], "has 9 joints, 1 to 8"),
    ],
)
def test_what_cannot_be_a_table_is_one_line_and_no_file(
    tmp_path, refused, change, options, complaint
):
    messages = session_messages(3, STATES)
    path, out = record(tmp_path / "run", change(messages)), tmp_path / "out" / "run.csv"
    out.parent.mkdir()
    assert complaint in refused("recordings", "to-table", path, "--out", out, *options)
    assert not list(out.parent.iterdir())


@pytest.mark.parametrize("suffix", ["csv", "csv.gz", "parquet", "mcap"])
def test_a_file_that_cannot_be_read_is_one_line_without_another_error_before_it(tmp_path, suffix):
    path = tmp_path / f"run.{suffix}"
    for content in (None, b"\xff\x00\xfe" * 20):
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(UsageError, match=re.escape(str(path))) as caught:
            read_recording(path)
        error = caught.value
        assert "\n" not in str(error)
        assert error.__cause__ is None
        assert error.__context__ is None or error.__suppress_context__
