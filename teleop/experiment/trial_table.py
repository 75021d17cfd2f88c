"""The table of a participant's trials: a row a trial, on the disk before the next trial begins.

A folder has `design.json`, which all participants share, and `participant-N.csv`. The rows are the
state of the experiment: replaying them gives the next trial.
"""

import csv
import fcntl
import io
import json
import os
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

from teleop.errors import UsageError
from teleop.experiment.design import Trial, TrialSequence
from teleop.runtime.output_file import replace_file

DESIGN_FILE = "design.json"
_BEFORE = ("participant", "session", "trial", "block", "procedure")
_AFTER = (
    "stimulus", "target", "response", "correct", "response_time_s", "attempts", "recording",
    "begin_stamp_ns", "time",
)  # fmt: skip


def build_columns(factors: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of the columns, those of the conditions among them.

    Raises `UsageError` if a factor has the name of another column.
    """
    for name in factors:
        if name in _BEFORE + _AFTER or not name.isprintable():
            raise UsageError(f"factor {name!r}: is the name of a column of the table; rename it")
    return (*_BEFORE, *factors, *_AFTER)


def read_trials(path: str | Path) -> list[dict[str, str]]:
    """Return the rows of a table, or of all tables of a folder, as text by column.

    A torn last row, of a running or interrupted experiment, is left out.

    Raises
    ------
    UsageError
        There is no table, or one is damaged; one line.
    """
    folder = Path(path)
    paths = sorted(folder.glob("participant-*.csv")) if folder.is_dir() else [folder]
    if not paths:
        raise UsageError(f"{folder}: has no participant-*.csv")
    try:
        return [row for each in paths for row in _parse(each, _cut_torn_row(each.read_bytes()))]
    except OSError as error:
        raise UsageError(f"{error.filename}: {error.strerror}") from error


class TrialTable:
    """The table of one participant, open for the trials that follow; a context manager.

    Parameters
    ----------
    folder : Path
        Of the whole experiment; made if it is missing.
    participant : int
        From 1.
    description : mapping
        All that must not change, as plain data; compared with that of earlier trials.
    factors : mapping
        Its keys are columns.

    Raises
    ------
    UsageError
        On entering: the folder is of another design, another program writes this table, or it is
        damaged; one line.
    """

    def __init__(
        self,
        folder: Path,
        participant: int,
        description: Mapping[str, Any],
        factors: Mapping[str, Any],
    ) -> None:
        self.path = folder / f"participant-{participant}.csv"
        self.rows: list[dict[str, str]] = []
        self._participant, self._description = participant, description
        self._factors, self._columns = tuple(factors), build_columns(factors)
        self._file: BinaryIO | None = None

    def __enter__(self) -> Self:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            _keep_design(self.path.parent / DESIGN_FILE, self._description)
            self._file = self.path.open("a+b")
        except OSError as error:
            raise UsageError(f"{self.path.parent}: {error.strerror}") from error
        try:
            self._open(self._file)
        except BaseException:
            self._file.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        if self._file is not None:
            self._file.close()

    def _open(self, file: BinaryIO) -> None:
        """Lock the table, cut a torn last row off, and read the others."""
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise UsageError(f"{self.path}: another program writes it; end that first") from None
        file.seek(0)
        data = _cut_torn_row(file.read())
        file.truncate(len(data))
        if not data:
            self._write(self._columns)
            return
        if tuple(next(csv.reader(io.StringIO(data.decode(errors="replace"))))) != self._columns:
            raise UsageError(f"{self.path}: has other columns; use another folder")
        self.rows = list(_parse(self.path, data))

    def replay(self, sequence: TrialSequence) -> None:
        """Bring a sequence to where these rows end.

        Raises `UsageError` if a row is not the trial that the design gives.
        """
        for line, row in enumerate(self.rows, 2):
            expected = None if sequence.is_done else self._describe_trial(sequence.choose_trial())
            if expected is None or any(row[name] != text for name, text in expected.items()):
                raise UsageError(
                    f"{self.path}, line {line}: is not the trial that this design gives; go on "
                    "with the program that made the table, or use another folder"
                )
            sequence.record(row["response"])

    def append(self, trial: Trial, values: Mapping[str, Any]) -> None:
        """Write a row, `values` in the columns that are not the trial's own.

        On return it is on the disk.
        """
        texts = {name: format_value(value) for name, value in values.items()}
        row = self._describe_trial(trial) | texts
        self._write(tuple(row[name] for name in self._columns))
        self.rows.append(row)

    def _describe_trial(self, trial: Trial) -> dict[str, str]:
        values = {
            "participant": self._participant,
            "trial": trial.number,
            "block": trial.block,
            **{name: trial.condition[name] for name in self._factors},
            "stimulus": trial.stimulus,
            "target": trial.target,
        }
        return {name: format_value(value) for name, value in values.items()}

    def _write(self, cells: tuple[str, ...]) -> None:
        assert self._file is not None  # noqa: S101 - open, as in a `with` block
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerow(cells)
        self._file.write(text.getvalue().encode())
        self._file.flush()
        os.fsync(self._file.fileno())


def format_value(value: Any) -> str:
    """Return a value as a cell: floats with all digits, true and false as 1 and 0, None empty."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(int(value))
    return repr(float(value)) if isinstance(value, float) else str(value)


def _cut_torn_row(data: bytes) -> bytes:
    """Return the complete rows: each ends its line, and a crash may leave zeros behind them."""
    return data[: data.rstrip(b"\0").rfind(b"\n") + 1]


def _parse(path: Path, data: bytes) -> list[dict[str, str]]:
    rows = list(csv.reader(io.StringIO(data.decode(errors="replace"))))
    for line, row in enumerate(rows, 1):
        if len(row) != len(rows[0]):
            raise UsageError(f"{path}, line {line}: has {len(row)} cells, not {len(rows[0])}")
    return [dict(zip(rows[0], row, strict=True)) for row in rows[1:]]


def _keep_design(path: Path, description: Mapping[str, Any]) -> None:
    """Write the design of a new experiment; `UsageError` if a different one is there."""
    if not path.exists():
        with replace_file(path) as partial, partial.open("w") as file:
            json.dump(description, file, indent=2)
            file.flush()
            os.fsync(file.fileno())
        return
    try:
        earlier = json.loads(path.read_text())
        before, now = _flatten(earlier), _flatten(json.loads(json.dumps(description)))
    except ValueError as error:
        raise UsageError(f"{path}: is not a design: {error}") from error
    for key in sorted(before.keys() | now.keys()):
        if before.get(key) != now.get(key):
            raise UsageError(
                f"{path}: {key} was {before.get(key)}, is {now.get(key)}; a changed design needs "
                "another folder"
            )


def _flatten(tree: Any, key: str = "") -> dict[str, str]:
    """Return the leaves of plain data as JSON by dotted key; a list is a leaf."""
    if not isinstance(tree, dict):
        return {key: json.dumps(tree)}
    pairs = [_flatten(value, f"{key}.{name}" if key else name) for name, value in tree.items()]
    return {name: text for pair in pairs for name, text in pair.items()}
