import gzip
import os

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop.data import file_formats, read_limits, table_parser
from teleop.data.measured_table import Columns, read_table, read_tables, write_table
from teleop.errors import UsageError
from teleop.messages.messages import MAX_TENDONS, TendonState, pad_values
from teleop.messages.topics import TENDONS
from tests.teleop.data.records import refusal
from tests.teleop.recorded import START_NS, record

GOOD = "time_s,proximal_tension_N\n0.0,1.0\n0.1,2.0\n0.2,3.0\n"
HEAD = "time_s,proximal_tension_N,proximal_displacement_m\n"


# --- what is accepted


def test_columns_that_may_be_missing_are_none_and_further_ones_are_kept(path):
    path.write_text("note,time_s,temperature,proximal_tension_N\na,0,20.5,1\nb,0.1,20.6,2\n")
    table = read_table(path)
    assert table.time.tolist() == [0.0, 0.1]
    assert table.proximal_tension.tolist() == [1.0, 2.0]
    assert table.proximal_displacement is None
    assert table.distal_tension is None
    assert table.distal_displacement is None
    assert table.extra["temperature"].tolist() == [20.5, 20.6]
    assert table.extra["note"].tolist() == ["a", "b"]
    assert set(table.columns()) == {"time_s", "proximal_tension_N", "temperature", "note"}


def test_integers_and_floats_of_any_width_from_parquet(tmp_path):
    path = tmp_path / "data.parquet"
    columns = {
        "time_s": pa.array([0, 1, 2], pa.int32()),
        "proximal_tension_N": pa.array([1.5, 2.5, 3.5], pa.float32()),
        "when": pa.array(["a", None, "c"]),
    }
    pq.write_table(pa.table(columns), path)
    table = read_table(path, Columns("time_s[s]"))
    assert table.time.tolist() == [0.0, 1.0, 2.0]
    assert table.proximal_tension.dtype == np.float64
    assert table.extra["when"].tolist() == ["a", None, "c"]


def test_a_recording_is_a_table(tmp_path):
    expected = np.arange(1.0, 11.0)
    nothing = (np.nan,) * MAX_TENDONS
    sent = []
    for k, tension in enumerate(expected):
        message = TendonState(
            tendons=2,
            time_s=0.1 * k,
            proximal_tension=pad_values([tension, 2 * tension], MAX_TENDONS),
            proximal_displacement=(0.001 * k, *nothing[1:]),
            bench_distal_tension=nothing,
            bench_distal_displacement=nothing,
        )
        sent.append((TENDONS, message, START_NS + k * 10**8))
    path = record(tmp_path, sent)
    first, second = read_tables(path, (Columns(), Columns.from_tendon(2)))
    assert first.time == pytest.approx(0.1 * np.arange(10))
    assert first.proximal_tension.tolist() == expected.tolist()
    assert second.proximal_tension.tolist() == (2 * expected).tolist()
    assert first.proximal_displacement == pytest.approx(0.001 * np.arange(10))
    assert second.proximal_displacement is None
    assert first.distal_tension is None


# --- what is refused, and how


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["is empty"]),
        ("time_s,proximal_tension_N\n", ["no rows"]),
        ("0,1\n0.1,2\n", ["'time_s'", "'time=COLUMN[UNIT]'", "'proximal_tension=COLUMN[UNIT]'"]),
        (
            "Time,F\n0,1\n",
            ["'time=Time[s]'; and the tension", "'proximal_tension=COLUMN[UNIT]'", "amperes"],
        ),
        (
            "Run Time [ms],Q,Drive Torque\n0,1,1\n",
            ["'time=Run Time [ms]'", "rate HZ; and", "'proximal_torque=Drive Torque[UNIT]'"],
        ),
        (
            "Time [s],T_in,Fout [mN],MotorPos\n0,1,1,1\n",
            [
                "--column 'proximal_tension=T_in[UNIT]' --column 'distal_tension=Fout [mN]' ",
                "--column 'proximal_displacement=MotorPos[UNIT]'",
            ],
        ),
        (
            "Zeit [s],Kraft distal [N],Kraft proximal [N],Weg [mm]\n0,1,1,1\n",
            [
                "the tension at the housing: --column 'proximal_tension=Kraft proximal [N]' ",
                "distal_tension=Kraft distal [N]'",
                "proximal_displacement=Weg [mm]'",
            ],
        ),
        (
            "timestamp,T_in\n2026-04-10T18:16:04.250,1\n2026-04-10T18:16:04.300,2\n",
            ["proximal_tension=T_in[UNIT]'"],
        ),
        (
            "Load left [N],Load right [N],time_s\n1,1,0\n",
            ["=Load left [N]'; or an antagonistic pair"],
        ),
        ("time_s,proximal_tensoin_N\n0,1\n", ["'proximal_tension_N'", "'proximal_tensoin_N'"]),
        ("time_s,time_s,proximal_tension_N\n0,0,1\n", ["'time_s'", "2 times"]),
        (
            HEAD.replace("_m\n", "_mn\n") + "0,1,2\n",
            ["displacement_mn' states no unit that fits", "_mn[m]'"],
        ),
        (HEAD + "0,1,0\n0.1,2,0\n\n0.2,x1,0\n", ["'proximal_tension_N', line 5", "'x1'"]),
        (HEAD + '0,1,0\n0.1,"2,5",0\n', ["line 3: '2,5'", "decimal comma", "'0.1'"]),
        (HEAD + "0,1,0\n0.1,2\n", ["line 3", "2 cells", "3 columns"]),
        (HEAD + "0,1,0\n0.2,1,0\n0.2,1,0\n", ["'time_s', line 4", "0.2 does not come after 0.2"]),
        (
            HEAD + "0,1,0\n0.1,nan,0\n0.2,,0\n0.3,4,0\n",
            ["tension_N'", "2 of 4", "line 3", "--drop"],
        ),
        (HEAD + "0,1,0\n0.1,10,0\n0.2,-0.5,0\n", ["tension_N', line 4", "-0.5 N", "cannot push"]),
        (HEAD + "0,1,0\n0.1,20000,0\n", ["tension_N', line 3", "20000", "newtons"]),
        (HEAD + "0,1,0\n0.1,1,14\n", ["displacement_m', line 3", "14 m", "metres"]),
        (HEAD + "0,1,0\n12,1,0\n24,1,0\n", ["'time_s'", "12 s apart", "milliseconds"]),
        (b"time_s,proximal_tension_N\n0,\xff\n", ["line 2: 'ÿ' is not a number"]),
        (b"time_s,proximal_tension_N\n0,5\n1,1_5\n", ["line 3: '1_5' is not a number"]),
        ('time_s,proximal_tension_N\n0,"1\n', ["cannot be read"]),
    ],
)
def test_what_cannot_be_right_is_refused_in_one_line(path, text, parts):
    message = refusal(path, text)
    for part in parts:
        assert part in message


def test_the_line_named_is_the_files_far_down_too(path):
    rows = [f"{k},1,0\n" for k in range(45_000)]
    rows[43_210] = "43210,oops,0\n"
    assert "line 43212: 'oops'" in refusal(path, HEAD + "".join(rows))


def test_a_diagnosis_reads_a_zero_that_is_off_and_spikes_but_no_wrong_sign(path):
    pull = 10.0 * np.sin(np.linspace(0.0, np.pi, 50))

    def rows(tension):
        return HEAD + "".join(f"{0.1 * k:.1f},{T:.3f},0\n" for k, T in enumerate(tension))

    spiked = pull - 1.0
    spiked[20] = -8.0
    path.write_text(rows(spiked))
    assert read_table(path, zero_errors=["proximal_tension"]).proximal_tension.min() == -8.0
    assert "cannot push" in refusal(path)
    assert "a zero offset" in refusal(path, rows(-pull), zero_errors=["proximal_tension"])


def test_rows_that_are_not_finite_are_left_out_when_asked(path):
    path.write_text(HEAD + "0,1,0\n0.1,nan,0\n0.2,3,inf\n0.3,,0\n0.4,5,0.001\n0.5,-9,0\n")
    message = refusal(path, drop_nonfinite=True)
    assert "line 7" in message  # rows behind the dropped ones keep their lines
    path.write_text(HEAD + "0,1,0\n0.1,nan,0\n0.2,3,inf\n0.3,,0\n0.4,5,0.001\n")
    table = read_table(path, drop_nonfinite=True)
    assert table.dropped == 3
    assert table.time.tolist() == [0.0, 0.4]
    assert table.proximal_tension.tolist() == [1.0, 5.0]
    path.write_text(HEAD + "0,nan,0\n")
    assert "no row" in refusal(path, drop_nonfinite=True)


def test_values_missing_in_one_column_are_kept_as_such_for_a_diagnosis(path):
    path.write_text(HEAD + "0,1,0\n0.1,nan,0.001\n0.2,3,inf\n0.3,,0\n")
    table = read_table(path, diagnosed=True)
    np.testing.assert_array_equal(table.time, [0.0, 0.1, 0.2, 0.3])
    np.testing.assert_array_equal(table.proximal_tension, [1.0, np.nan, 3.0, np.nan])
    np.testing.assert_array_equal(table.proximal_displacement, [0.0, 0.001, np.nan, 0.0])
    assert read_table(path, diagnosed=True, drop_nonfinite=True).dropped == 3
    assert "4 values are missing" in refusal(path)


@pytest.mark.parametrize(
    ("rows", "what"),
    [
        ("0,1,0\n,2,0\n", "'time_s': 1 of 2 values are missing"),
        ("0,1,\n0.1,2,nan\n", "'proximal_displacement_m' has no finite value"),
        ("0,,0\n0.1,-9,0\n0.2,3,0\n0.3,2,0\n", "line 3: -9 N: a tendon cannot push"),
        ("0,,0\n0.1,4000,0\n", "line 3: 4000 is too large"),
        ("0,1,\n0.1,2,0\n0.2,2,30\n", "line 4: travel spans 30 m"),
    ],
)
def test_the_values_beside_missing_ones_are_checked(path, rows, what):
    assert what in refusal(path, HEAD + rows, diagnosed=True)


def test_a_named_column_must_be_there_though_a_standard_one_need_not(path):
    path.write_text(GOOD)
    assert "'tip_N'" in refusal(path, columns=Columns(distal_tension="tip_N"))
    assert read_table(path).distal_tension is None


@pytest.mark.parametrize("suffix", ["csv", "csv.gz", "parquet", "mcap"])
def test_a_file_that_is_not_there_or_is_none_or_is_empty(tmp_path, suffix):
    assert "file not found" in refusal(tmp_path / f"gone.{suffix}")
    (tmp_path / f"folder.{suffix}").mkdir()
    os.mkfifo(tmp_path / f"pipe.{suffix}")
    (tmp_path / f"zero.{suffix}").symlink_to("/dev/zero")
    for name in ("folder", "pipe", "zero"):
        assert "is not a file" in refusal(tmp_path / f"{name}.{suffix}")
    assert "is empty" in refusal(tmp_path / f"empty.{suffix}", "")
    assert "allowed are .csv, .tsv, .txt" in refusal(tmp_path / "data.docx")


def test_a_damaged_or_cut_off_file_is_refused(tmp_path):
    for suffix in ("csv.gz", "parquet", "mcap"):
        refusal(tmp_path / f"damaged.{suffix}", GOOD)
    path = tmp_path / "cut.parquet"
    write_table(path, {"time_s": np.arange(999.0), "proximal_tension_N": np.ones(999)})
    refusal(path, path.read_bytes()[:-100])
    whole = gzip.compress(GOOD.encode() * 1000)
    assert "cut off" in refusal(tmp_path / "cut.csv.gz", whole[: len(whole) // 2])


# --- what is too large


@pytest.fixture
def small(monkeypatch):
    """Lower the bounds, so that a small file is too large."""
    for name, value in {"CELLS_MAX": 40, "COLUMNS_MAX": 4, "BLANK_MAX": 9}.items():
        monkeypatch.setattr(read_limits, name, value)
    monkeypatch.setattr(read_limits, "TEXT_MAX", 100_000)
    monkeypatch.setattr(read_limits, "LINE_MAX", 3000)
    monkeypatch.setattr(read_limits, "CELL_MAX", 1000)


LARGE = {
    "columns": ("a,b,c,d,e\n0,1,2,3,4\n", "5 columns, at most 4"),
    "a line": (GOOD + "0" * 4000 + "\n", "line 5: is longer than 3000"),
    "a line of names": ("a," * 4000 + "\n", "line 1: is longer than 3000"),
    "text": (GOOD.replace("0.2", "0.2" + 2000 * " ") + "0.3,1\n" * 30_000, "unpacks to more"),
}


@pytest.mark.parametrize(("suffix", "large"), [("csv", False), ("csv.gz", False), ("csv.gz", True)])
@pytest.mark.parametrize("kind", LARGE)
def test_text_that_unpacks_without_end_is_refused(
    tmp_path, small, monkeypatch, kind, suffix, large
):
    monkeypatch.setattr(table_parser, "LARGE_FILE_BYTES", 0 if large else 1 << 60)
    if kind == "text":
        monkeypatch.setattr(read_limits, "CELLS_MAX", 1 << 40)
    text, said = LARGE[kind]
    data = gzip.compress(text.encode()) if suffix == "csv.gz" else text.encode()
    assert said in refusal(tmp_path / f"large.{suffix}", data)


def test_blank_lines_without_end_are_refused(path, small):
    assert "line 14: more than 9 blank lines" in refusal(path, GOOD + "\n" * 20)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"time_s": np.arange(30.0), "b": np.ones(30)}, "2 columns have more than 20 rows"),
        ({name: [1.0] for name in "abcde"}, "5 columns, at most 4"),
        ({"time_s": [0.0], "note": ["x" * 1001]}, "'note' has a cell of more than 1000"),
    ],
)
def test_parquet_that_unpacks_without_end_is_refused(tmp_path, small, columns, said):
    path = tmp_path / "large.parquet"
    pq.write_table(pa.table(columns), path)
    assert said in refusal(path)


def test_a_footer_that_has_no_end_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(file_formats, "FOOTER_MAX", 100)
    path = tmp_path / "large.parquet"
    pq.write_table(pa.table({"time_s": [0.0]}), path)
    assert "its footer has" in refusal(path)


@pytest.mark.parametrize("blocks", [False, True])
def test_a_quoted_cell_without_end_is_refused_with_its_line(path, monkeypatch, blocks):
    monkeypatch.setattr(table_parser, "LARGE_FILE_BYTES", 0 if blocks else 1 << 60)
    note = "x" * 200_000  # within a line, beyond a cell
    text = f"time_s,proximal_tension_N,note\n0,1,a\n0.1,2,{note}\n0.2,-9,b\n"
    assert "field larger than" in refusal(path, text)


@pytest.mark.parametrize(
    ("column", "said"),
    [
        ([True, False], "row 1: 'true' is not a number"),
        (["1", "x"], "row 2: 'x'"),
        ([b"1", b"2"], "of type binary"),
        ([[1.0], [2.0]], "of type list"),
        (pa.array([1, 2], pa.duration("ms")), "of type duration"),
    ],
)
def test_what_is_no_number_in_parquet_is_not_taken_for_newtons(tmp_path, column, said):
    path = tmp_path / "data.parquet"
    pq.write_table(pa.table({"time_s": [0.0, 0.1], "proximal_tension_N": column}), path)
    assert said in refusal(path)


# --- writing


numbers = st.floats(allow_nan=False, allow_infinity=False, width=64)


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz", ".parquet"])
@settings(max_examples=15)
@given(
    rows=st.lists(
        st.tuples(st.floats(1e-9, 0.39), st.floats(0.0, 900.0), st.floats(-0.9, 0.9), numbers),
        min_size=1,
        max_size=30,
    )
)
def test_what_is_written_comes_back_bit_for_bit(tmp_path_factory, suffix, rows):
    path = tmp_path_factory.mktemp("round") / f"table{suffix}"
    steps, tension, displacement, extra = (np.array(column) for column in zip(*rows, strict=True))
    columns = {
        "time_s": np.cumsum(steps),
        "proximal_tension_N": tension,
        "proximal_displacement_m": displacement,
        "spare": extra,
    }
    if np.any(np.diff(columns["time_s"]) <= 0.0):
        return  # a step too small to tell from none
    write_table(path, columns)
    back = read_table(path, Columns("time_s[s]")).columns()  # at any speed
    assert list(back) == list(columns)
    for name, column in columns.items():
        assert back[name].tolist() == column.tolist()


def test_writing_replaces_a_file_whole_or_not_at_all(tmp_path):
    path = tmp_path / "table.csv"
    path.write_text("before")
    with pytest.raises(ValueError, match="shorter"):
        write_table(path, {"time_s": np.arange(3.0), "proximal_tension_N": np.arange(2.0)})
    assert path.read_text() == "before"
    assert [p.name for p in tmp_path.iterdir()] == ["table.csv"]
    write_table(path, {"time_s": np.arange(2) / 4, "proximal_tension_N": np.arange(2.0)})
    assert read_table(path).time.tolist() == [0.0, 0.25]
    assert [p.name for p in tmp_path.iterdir()] == ["table.csv"]


@pytest.mark.parametrize("name", ["out.mcap", "out.txt", "no/folder/out.csv"])
def test_a_table_that_cannot_be_written_is_refused(tmp_path, name):
    with pytest.raises(UsageError):
        write_table(tmp_path / name, {"time_s": np.arange(2.0)})
