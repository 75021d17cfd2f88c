"""Text tables as programs write them: bytes, text, rows, names and units, columns of numbers.

Each step is a pure function of what the file holds: the encoding, the separator, the lines of names
and of units, the decimal sign. Where two readings are possible, the file is refused with the
option that decides. Sheets of spreadsheets enter as rows of text.
"""

import contextlib
import csv
import io
import itertools
import re
from array import array
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from teleop.data import large_csv, read_limits, time_text
from teleop.data.column_units import TIME_NAMES, is_unit
from teleop.data.mapping_file import TableMapping
from teleop.data.raw_table import SEPARATORS, Column, Layout, RawTable, check_names, detect_encoding
from teleop.data.text_cells import (
    BLANKS,
    EXPONENT,
    NUMBERS,
    WITH_UNIT,
    classify_word,
    is_loose_value,
    parse_cells,
    to_number,
)
from teleop.errors import UsageError

Row = tuple[int, list[str]]  # its line, and its cells

LARGE_FILE_BYTES = 4_000_000  # [bytes] from which on a text file is read in blocks
COMPRESSION_RATIO = 20  # bytes of text of a byte of .csv.gz, at most as a rule
SAMPLE_LINES = 1000  # of a file, which tell its layout ...
SAMPLE_CHARACTERS = 300_000  # ... or less of a wide one
ROWS_PER_CHUNK = 20_000
NUMBERED_ROWS = 20  # from which on a column without a name is known to number them
FOOTER_ROWS = 100  # fewer lines of words at the end are left out

_OTHER_GROUP = re.compile(r"\d['’\u00a0\u202f ]\d{3}(?!\d)")
_ONE_SIGN = re.compile(rf"[+-]?(\d*)([.,])(\d+){EXPONENT}")
_RULE = re.compile(r"[\s|+:=-]*(?:---|===)[\s|+:=-]*")  # a line below the names


# --- text to rows


def split_rows(lines: Iterable[str], separator: str, *, strict: bool = True) -> Any:
    """Return a reader of the rows of lines of text; rules are blank, `->` follows a time stamp."""
    lines = ("\n" if _RULE.fullmatch(line) else line for line in lines)
    lines = (line.replace(" -> ", separator, 1) if " -> " in line else line for line in lines)
    if separator == " ":
        lines = (" ".join(re.split(r"[ \t\r\n]+", line.strip(" \t\r\n"))) + "\n" for line in lines)
    return csv.reader(lines, delimiter=separator, skipinitialspace=True, strict=strict)


def _sample_rows(lines: Sequence[str], separator: str, first_line: int) -> list[Row]:
    rows: list[Row] = []
    reader = split_rows(lines, separator, strict=False)
    try:
        for cells in reader:
            if any(map(str.strip, cells)):
                rows += [(first_line + reader.line_num - 1, cells)]
    except csv.Error:  # a cell that is too long: what is read tells the layout
        return rows
    return rows


def find_layout(path: Path, lines: Sequence[str], encoding: str, mapping: TableMapping) -> Layout:
    """Return the layout that the first lines of a file tell; `UsageError` if none is."""
    first_line, separator = 1, mapping.separator.replace("\\t", "\t")
    if stated := re.fullmatch(r"\W?sep=(.)\"?\s*", lines[0] if lines else ""):
        first_line, lines, separator = 2, lines[1:], separator or stated[1]
    heads = [k for k, line in enumerate(lines) if line.startswith("***End_of_Header***")]
    if heads:  # of LabVIEW: one of the file, one of the channels
        first_line, lines = first_line + heads[-1] + 1, lines[heads[-1] + 1 :]
    if not any(line.strip() for line in lines):
        raise UsageError(f"{path}: line 1: is blank, must contain the column names")
    if separator:
        rows = _sample_rows(lines, separator, first_line)
    else:
        split = {each: _sample_rows(lines, each, first_line) for each in SEPARATORS}
        scores = {each: _score_rows(rows) for each, rows in split.items()}
        separator = max(scores, key=lambda each: scores[each])
        if scores[separator] == 0.0:  # names alone, or no numbers
            head = next(line for line in lines if line.strip())
            separator = max(SEPARATORS, key=lambda each: head.count(each) if each != " " else 0)
        rows = split[separator]
    layout = locate_table(path, rows, separator, mapping)
    return replace(layout, encoding=encoding, separator=separator)


def _score_rows(rows: Sequence[Row]) -> float:
    """Return the share of values in rows of equal length; 0 of a single column."""
    tail = rows[len(rows) // 2 :]
    width = _find_width(tail)
    if width < 2:
        return 0.0
    whole = [cells for _, cells in tail if len(cells) == width]
    # a space separates columns rather than thousands, if there is a choice
    cells = [cell.strip() for cells in whole for cell in cells]
    values = sum(is_loose_value(c) and (" " not in c or time_text.is_moment(c)) for c in cells)
    values += sum(WITH_UNIT.fullmatch(cell) is not None for cell in cells)
    blank = sum(classify_word(cell) != "" for cell in cells)
    return len(whole) / len(tail) * (values + (blank if values else 0)) / (width * len(whole))


def _find_width(rows: Sequence[Row]) -> int:
    counts = Counter(len(cells) for _, cells in rows)
    return max(counts, key=lambda width: (counts[width], width), default=0)


# --- rows to names and units


def clean_name(cell: str) -> str:
    """Return a column's name without what programs put around it."""
    name = " ".join(cell.replace("\u00a0", " ").split()).strip(BLANKS)
    return name.lstrip("#%").strip(BLANKS) if name.startswith(("#", "%")) else name


def locate_table(
    path: Path,
    rows: Sequence[Row],
    separator: str,
    mapping: TableMapping,
    *,
    decimal: str | None = None,
) -> Layout:
    """Return names, units and place of the table among rows; `UsageError` if there is none."""
    tail = rows[len(rows) // 2 :] if len(rows) > 1 else rows
    width = _find_width(tail)
    whole = [cells for _, cells in tail if len(cells) == width]
    numeric = [
        k
        for k in range(width)
        if 2 * sum(is_loose_value(cells[k]) for cells in whole) >= max(len(whole), 1)
    ]
    data = (i for i, (_, cells) in enumerate(rows) if _is_data(cells, width, numeric))
    begin = next(data, min(len(rows), 1))  # or names alone
    header = _find_header(rows[:begin], width)
    if header is None and (begin or len(rows) < 2):
        line = rows[0][0]
        raise UsageError(f"{path}: line {line}: contains numbers, must contain the column names")
    if decimal is None:
        decimal = _find_decimal(path, rows[begin:], separator, mapping)
    line, cells = rows[header or 0]
    names = [clean_name(cell) for cell in cells]
    while names and not names[-1]:
        names.pop()
    if header is not None and names and len(cells) != width and begin < len(rows):
        names = _fit_names(_resplit_names(cells, separator, width) or names, rows[begin:], width)
        comments = all(re.match(r"\s*[#%]", row[0]) for _, row in rows[:begin])
        if len(names) != width and (comments or len(names) == 1 < width):
            header = None
        elif separator != " " and len(names) > width and not any(map(is_unit, names)):
            more = (cell for _, row in rows[begin:] for cell in row[width:])
            if not any(map(is_loose_value, more)):
                blank = [not any(cells[k].strip() for cells in whole) for k in range(width)]
                names = names[: width - [*blank[::-1], False].index(False)]
    if header is None and _is_count([cells for _, cells in rows[begin : begin + 2]]):
        header, (line, cells) = begin, rows[begin]
        names = [clean_name(cell) for cell in cells]
    if header is None:
        read_limits.check_size(path, width, 0, "keep those that are needed")
        names = [f"column {k + 1}" for k in range(width)]
        return Layout(tuple(names), 0, rows[begin][0] - 1, decimal=decimal)
    check_names(path, line, names)
    following = rows[header + 1] if header + 1 < len(rows) else (line, [])
    if header + 2 < begin and _is_units_row(rows[header + 2][1], width):
        following = rows[header + 2]
    units, line_above = dict[str, str](), line
    if header + 1 < max(begin, header + 2) and _is_units_row(following[1][: len(names)], width):
        units = {
            n: c.strip(" []()") for n, c in zip(names, following[1], strict=False) if c.strip()
        }
        line_above = following[0]
    return Layout(tuple(names), line, line_above, units, decimal=decimal, width=len(cells))


def _is_data(cells: Sequence[str], width: int, numeric: Sequence[int]) -> bool:
    return (
        len(cells) == width
        and any(is_loose_value(cells[k]) for k in numeric)
        and all(is_loose_value(cells[k]) or classify_word(cells[k]) for k in numeric)
    )


def _find_header(above: Sequence[Row], width: int) -> int | None:
    """Return which row above the data has the names."""

    def has_names(cells: Sequence[str]) -> bool:
        return not any(map(is_loose_value, cells))

    texts = [i for i, (_, cells) in enumerate(above) if has_names(cells)]
    fitting = [i for i in texts if len(above[i][1]) == width] or texts[-1:]
    if not fitting:
        mixed = above and not all(map(is_loose_value, filter(str.strip, above[0][1])))
        return 0 if mixed else None
    last = fitting[-1]
    if last > 0 and len(above[last - 1][1]) == width and _is_units_row(above[last][1], width):
        if all(map(is_loose_value, above[last - 1][1])):
            return last
        beyond = [clean_name(cell).lower() for cell in above[max(last - 2, 0)][1]]
        described = len(beyond) == width and last > 1 and {"t", *TIME_NAMES} & {*beyond}
        return last - 2 if described else last - 1
    return last


def _is_count(rows: Sequence[Sequence[str]]) -> bool:
    """Return whether the first row counts the columns, as pandas writes in place of names."""
    names = [name for cell in rows[0] if (name := cell.strip())] if rows else []
    counted = names in [[str(k + n) for k in range(len(names))] for n in (0, 1)]
    return counted and len(names) > 1 and (len(names) > 2 or "." in rows[-1][-1])


def _is_units_row(cells: Sequence[str], width: int) -> bool:
    filled = [cell.strip(" []()") for cell in cells if cell.strip()]
    known = sum(map(is_unit, filled))
    short = all(len(each) <= 8 and not is_loose_value(each) for each in filled)
    return len(cells) <= width and known > 0 and 2 * known >= len(filled) and short


def _fit_names(names: list[str], rows: Sequence[Row], width: int) -> list[str]:
    """Return names of which each has its unit beside it, or that lack one for the rows' numbers."""
    if len(names) == 2 * width and all(map(is_unit, names[1::2])):
        return [f"{name} [{unit}]" for name, unit in zip(names[::2], names[1::2], strict=True)]
    whole = [cells for _, cells in rows if len(cells) == width]
    if width == len(names) + 1 > 2 and len(whole) >= NUMBERED_ROWS:
        index = [cells[0].strip(BLANKS) for cells in whole]
        times = [to_number(cells[1], "") or 0.0 for cells in whole]
        counted = index in [[str(k + n) for k in range(len(index))] for n in (0, 1)]
        if counted and all(a < b for a, b in itertools.pairwise(times)):
            return ["", *names]
    return names


def _resplit_names(cells: Sequence[str], separator: str, width: int) -> list[str]:
    """Return names that are separated otherwise than the numbers, if that gives one a column."""
    text = separator.join(cells)
    for other in SEPARATORS:
        names_text = text.strip().lstrip("#%").strip() if other == " " else text
        words: list[str] = next(split_rows([names_text], other, strict=False), [])
        names = [clean_name(word) for word in words]
        if len(names) == width and all(names):
            return names
    return []


# --- cells to numbers


def _find_decimal(path: Path, rows: Sequence[Row], separator: str, mapping: TableMapping) -> str:
    """Return the decimal sign of a table: "." or ",", or "" if no number tells."""
    if mapping.decimal:
        return "," if mapping.decimal == "comma" else "."
    evidence: dict[str, Row] = {}
    other_groups = False  # thousands are separated by neither sign
    sole_signs: set[int] = set()
    open_cells: dict[int, tuple[int, str]] = {}  # by column: thousands, or three decimals
    for line, cells in rows:
        for k, cell in enumerate(cells):
            text = cell.strip(BLANKS)
            if text.isdigit():
                sole_signs.add(k)
            other_groups |= _OTHER_GROUP.search(text) is not None
            match = _ONE_SIGN.fullmatch(text)
            if (
                match
                and re.fullmatch(r"[1-9]\d{0,2}", match[1])
                and len(match[3]) == 3
                and "e" not in text
            ):
                if match[2] == "," or separator != ",":
                    open_cells.setdefault(k, (line, text))
                else:
                    evidence.setdefault(".", (line, [text]))
            elif match:
                evidence.setdefault(match[2], (line, [text]))
            else:  # with thousands separators, which one of both signs explains
                signs = [sign for sign, form in NUMBERS.items() if form.fullmatch(text)]
                if len(signs) == 1 and {",", "."} & set(text):
                    evidence.setdefault(signs[0], (line, [text]))
    if len(evidence) == 2:
        (comma, (text,)), (point, (other,)) = evidence[","], evidence["."]
        raise UsageError(
            f"{path}: line {comma}: {text!r} has a decimal comma, {other!r} in line {point} "
            "a point; write decimals with a point"
        )
    open_signs = {text.strip("+-0123456789")[0] for _, text in open_cells.values()}
    if other_groups and not evidence and len(open_signs) == 1:
        return open_signs.pop()
    for k, (line, text) in open_cells.items():
        sign = text.strip("+-0123456789")[0]
        if sign not in evidence and (not evidence or k not in sole_signs):
            raise UsageError(
                f"{path}: line {line}: is {text!r} a number of thousands, or one with three "
                "decimals? Say --decimal point or --decimal comma"
            )
    return next(iter(evidence), "")


def read_rows(path: Path, layout: Layout, rows: Iterable[Row], unit: str = "line") -> RawTable:
    """Return the columns of the rows below the names; `UsageError` names the place of a fault.

    A place is a `unit` with its number.
    """
    names, lines, breaks = layout.names, array("q"), list[int]()
    words = {name: Counter[str]() for name in names}
    remarks = [*layout.describe()]
    rows = _drop_notes(rows, layout, unit, remarks)
    parts: list[list[Column]] = []
    fitted = _fit_rows(path, layout, rows, lines, breaks, unit)
    while chunk := list(itertools.islice(fitted, ROWS_PER_CHUNK)):
        parts.append(
            [
                parse_cells(cells, layout.decimal, words[name])
                for name, cells in zip(names, zip(*chunk, strict=True), strict=True)
            ]
        )
        read_limits.check_size(path, len(names), len(lines), "split the file")
    columns = {
        name or f"column {i + 1}": np.concatenate([p[i] for p in parts]) if parts else np.empty(0)
        for i, name in enumerate(names)
        if name or any(not _is_blank(part[i]) for part in parts)
    }
    return RawTable(
        path,
        columns,
        lambda row: f"{unit} {lines[row]}",
        units=layout.units,
        decimal=layout.decimal,
        words={name: found for name, found in words.items() if found},
        remarks=tuple(remarks),
        breaks=tuple(row for row in breaks if 0 < row < len(lines)),
    )


def _drop_notes(
    rows: Iterable[Row], layout: Layout, unit: str, remarks: list[str]
) -> Iterator[Row]:
    """Yield rows up to words at the end, where others have a number, without cells beside names."""
    rows, above, right = iter(rows), "", slice(len(layout.names), layout.width)
    remark = f"cells right of {layout.names[-1]!r}, without names, left out"
    for line, cells in rows:
        if len(cells) <= layout.width and any(map(str.strip, cells[right])):
            del cells[right]
            remarks += [remark] * (remark not in remarks)
        if _is_label(cells) and is_loose_value(above):
            tail = [(line, cells), *itertools.islice(rows, FOOTER_ROWS)]
            if len(tail) <= FOOTER_ROWS and all(_is_label(row) or not any(row) for _, row in tail):
                remarks.append(f"from {unit} {line} on ({cells[0]}) left out: no samples")
            else:
                yield from itertools.chain(tail, rows)
            return
        above = cells[0] if any(cells) else above
        yield line, cells


def _is_label(cells: Sequence[str]) -> bool:
    return bool(cells) and cells[0][:1].isalpha() and not classify_word(cells[0])


def _is_blank(column: Column) -> bool:
    return bool(column.dtype != object and np.isnan(column).all())


def _fit_rows(
    path: Path,
    layout: Layout,
    rows: Iterable[Row],
    lines: "array[int]",
    breaks: list[int],
    unit: str,
) -> Iterator[Sequence[str]]:
    """Yield the rows as long as the names, and record their lines; blank rows are skipped.

    `breaks` become the rows above which the names come again.
    """
    width, rows = len(layout.names), iter(rows)
    for line, cells in rows:
        if not cells or (len(cells) > 1 and not any(map(str.strip, cells))):
            continue
        if len(cells) > width and not any(map(str.strip, cells[width:])):
            del cells[width:]
        if len(cells) != width:
            hint = "; correct it, or remove it"
            if layout.separator == "," and len(cells) == 2 * width:
                hint = "; commas in numbers, and between them: save it with semicolons"
            elif next(iter(rows), None) is None:
                hint = "; the file ends with it: remove this line if it was cut, or is a footer"
            raise UsageError(
                f"{path}: {unit} {line}: has {len(cells)} cells, "
                f"{unit} {layout.names_line or layout.data_line + 1} "
                f"{'names' if layout.names_line else 'has'} {width} columns{hint}"
            )
        if clean_name(cells[-1]) == layout.names[-1] and [*map(clean_name, cells)] == [
            *layout.names
        ]:
            breaks.append(len(lines))
            continue
        if breaks and breaks[-1] == len(lines) and layout.has_units(cells):
            continue
        lines.append(line)
        yield cells


# --- a file


@contextlib.contextmanager
def open_lines(path: Path, encoding: str) -> Iterator[Iterator[str]]:
    """Open the lines of a text file, packed or not."""
    with path.open("rb") as file:
        packed = large_csv.unpack_text(path, file)
        yield read_limits.read_bounded_lines(path, io.TextIOWrapper(packed, encoding, newline=""))


def read_text(path: Path, mapping: TableMapping) -> RawTable:
    """Read a text table; in Windows-1252 or Latin-1 if it is not UTF-8. Raises `UsageError`."""
    with path.open("rb") as file:
        head = large_csv.unpack_text(path, file).peek(400)[:400]
    encoding = detect_encoding(path, head)
    more = ("cp1252", "latin-1") if encoding == "utf-8-sig" else ()
    for name in (encoding, *more):
        with contextlib.suppress(UnicodeDecodeError):
            return _read_encoded(path, name, mapping)
    raise UsageError(f"{path}: cannot be read: it is not {encoding} text")


def _read_encoded(path: Path, encoding: str, mapping: TableMapping) -> RawTable:
    with open_lines(path, encoding) as lines:
        size, sample = 0, list[str]()
        while size < SAMPLE_CHARACTERS and len(sample) < SAMPLE_LINES and (line := next(lines, "")):
            size += len(line)
            sample.append(line)
    layout = find_layout(path, sample, encoding, mapping)
    packed = path.name.lower().endswith(".gz")
    large = LARGE_FILE_BYTES // COMPRESSION_RATIO if packed else LARGE_FILE_BYTES
    if path.stat().st_size >= large and encoding == "utf-8-sig" and layout.separator != " ":
        first: list[str] = next(
            split_rows(sample[layout.data_line :], layout.separator, strict=False), []
        )
        columns = large_csv.read(path, layout, first)
        if columns is not None:
            return RawTable(
                path,
                columns,
                lambda row: f"line {_find_line(path, layout, row)}",
                units=layout.units,
                decimal=layout.decimal,
                remarks=layout.describe(),
            )
    with open_lines(path, encoding) as lines:
        return read_rows(path, layout, _number_rows(lines, layout))


def _number_rows(lines: Iterator[str], layout: Layout, *, strict: bool = True) -> Iterator[Row]:
    """Yield the rows below the names with their lines, of which the first is line 1."""
    below = itertools.islice(lines, layout.data_line, None)
    reader = split_rows(below, layout.separator, strict=strict)
    for cells in reader:
        yield layout.data_line + reader.line_num, cells


def _find_line(path: Path, layout: Layout, row: int) -> int:
    """Return the line of a row of a file that was read in blocks."""
    with open_lines(path, layout.encoding) as lines:
        full = (line for line, cells in _number_rows(lines, layout, strict=False) if cells)
        return next(itertools.islice(full, row, None))
