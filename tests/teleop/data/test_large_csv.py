"""The reader of large CSV files gives what the reader of rows gives, or leaves the file to it."""

import gzip

import numpy as np
import pytest

from teleop.data import file_formats, large_csv, table_parser
from teleop.errors import UsageError

HEAD = "time_s,proximal_tension_N,note\n"
TEXTS = {
    "numbers": "a,b\n0,1.5\n1,-2e-3\n2,1e300\n",
    "byte-order mark and CRLF": "\ufeffa,b\r\n0,1\r\n1,2\r\n",
    "blank lines": "a,b\n\n0,1\n\n\n1,2\n\n",
    "spaces": "a,b\n 0 , 1\n1,\t2\n",
    "blank cells": "a,b\n0,\n1,2\n",
    "not finite": "a,b\n0,nan\n1,inf\n2,-inf\n3,NaN\n",
    "quotes": '"a","b"\n"0","1"\n1,2\n',
    "text column": HEAD + "0,1,begin\n1,2,\n2,3,7\n",
    "text over lines": HEAD + '0,1,"a\nb"\n1,2,c\n',
    "text among numbers": "a,b\n" + "0,1\n" * 9 + "9,oops\n",
    "numbers after text": HEAD + "0,1,word\n" + "1,2,3\n" * 9,
    "words of other programs": "a,b\n0,NA\n1,null\n2,N/A\n3,true\n",
    "large whole numbers": "a,b\n0,9007199254740993\n1,123456789012345678901234567890\n",
    "digits": "a,b\n0,0.1234567890123456789\n1,2.2250738585072011e-308\n",
    "unequal rows": "a,b\n0,1\n1\n",
    "too many cells": "a,b\n0,1\n1,2,3\n",
    "no end of line": "a,b\n0,1\n1,2",
    "open quote": 'a,b\n0,1\n1,"2\n',
    "twice": "a,a\n0,1\n",
    "semicolons": "a;b\n0;1\n",
    "nul": "a,b\n0,1\n1,\x00\n",
}


def read(path, large, monkeypatch):
    monkeypatch.setattr(table_parser, "LARGE_FILE_BYTES", 0 if large else 1 << 60)
    try:
        raw = file_formats.read_columns(path)
    except UsageError as error:
        return str(error)
    rows = len(next(iter(raw.columns.values())))
    return (
        {name: (column.dtype, column.tolist()) for name, column in raw.columns.items()},
        [raw.place(row) for row in range(rows)],
    )


@pytest.mark.parametrize("kind", TEXTS)
def test_both_readers_agree(tmp_path, monkeypatch, kind):
    packed = kind.startswith("text")
    path = tmp_path / ("x.csv.gz" if packed else "x.csv")
    data = TEXTS[kind].encode()
    path.write_bytes(gzip.compress(data) if packed else data)
    by_rows, by_blocks = (read(path, large, monkeypatch) for large in (False, True))
    assert repr(by_blocks) == repr(by_rows)  # NaN is not itself


def test_it_is_used_and_says_how_far_it_is(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(table_parser, "LARGE_FILE_BYTES", 0)
    monkeypatch.setattr(table_parser, "read_rows", lambda *_: pytest.fail("read by rows"))
    monkeypatch.setattr(large_csv, "PROGRESS_DELAY_S", -1.0)
    monkeypatch.setattr(large_csv, "BLOCK_BYTES", 1 << 12)
    numbers = np.arange(20_000.0)
    path = tmp_path / "x.csv"
    file_formats.write_table(path, {"a": numbers, "b": numbers / 7.0})
    raw = file_formats.read_columns(path)
    assert np.array_equal(raw.columns["b"], numbers / 7.0)
    assert f"reading {path}" in capsys.readouterr().err


@pytest.mark.parametrize("cut", [0.2, 0.9])
def test_a_cut_off_file_is_not_taken_for_a_shorter_one(tmp_path, monkeypatch, cut):
    monkeypatch.setattr(table_parser, "LARGE_FILE_BYTES", 0)
    text = "a,b\n" + "".join(f"{k},{k / 7}\n" for k in range(9000))
    data = gzip.compress(text.encode())
    path = tmp_path / "x.csv.gz"
    path.write_bytes(data[: int(cut * len(data))])
    with pytest.raises(UsageError, match="damaged or cut off"):
        file_formats.read_columns(path)
