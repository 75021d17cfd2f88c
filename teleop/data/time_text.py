"""Times written as text: ISO 8601, a time of day, a date and a time; as seconds since the first."""

import datetime
import re
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array

NS = 1_000_000_000
HOUR_NS = 3600 * NS
DAY_NS = 24 * HOUR_NS
_ZONE = re.compile(r"(?<![A-Za-z])(?!AM$|PM$)(?:Z|[+-]\d\d(?::?\d\d)?|[A-Z]{3,5})$")

_MOMENT = re.compile(
    r"(?:(?P<days>\d+) days?\s+|(?P<date>\d{1,4}([-/. ])\w{1,9}\3\d{1,4})[T ,:]\s*)?"
    r"(?P<hour>\d{1,2}):(?P<minute>\d\d):(?P<second>\d\d)(?:[.,](?P<fraction>\d{1,9})\d*)?"
    r"\s*(?P<half>[AaPp]\.?[Mm]\.?)?\s*(?P<zone>Z|[+-]\d\d(?::?\d\d)?|[A-Z]{3,5})?"
)


def is_moment(text: str) -> bool:
    """Return whether a text is a time of day, with a date or without."""
    return ":" in text and _MOMENT.fullmatch(text.strip()) is not None


def has_moments(column: NDArray[Any]) -> bool:
    """Return whether a column is one of times as text."""
    return bool(column.dtype == object and any(is_moment(str(c or "")) for c in column[:9]))


def to_seconds(
    cells: NDArray[Any],
    place: Callable[[int], str],
    form: str = "",
    dates: NDArray[Any] | None = None,
) -> Array:
    """Return times since the first one [s], NaN where a cell is blank.

    Only differences count, so the order of day and month need not be known: another date in the
    next row is the next day if the time of day falls, and midnight passes without a date where it
    falls by more than half a day.

    `place` returns the place of a row in the file; `form` is a format of `strptime`, by default the
    forms of this module's docstring; `dates` are the cells of a column of dates beside a time of
    day. Raises `ValueError`, with the place, if a cell is no such time, or it cannot be told how
    many days passed.
    """
    moments = np.zeros(len(cells), dtype=np.int64)
    blank = np.zeros(len(cells), dtype=np.bool_)
    days, day, previous_ns = "", 0, -1
    origin: int | None = None  # day of the first date
    for row, cell in enumerate(cells):
        if not str(cell or "").strip():
            blank[row] = True
            continue
        try:
            date, clock_ns = _parse(str(cell).strip(), form)
        except ValueError:
            example = "; give time_format in --mapping FILE, such as '%M:%S.%f'"
            raise ValueError(f"{place(row)}: {cell[:40]!r} is not a time{example}") from None
        date = date or (str(dates[row]).strip() if dates is not None else "")
        if (ordinal := _to_ordinal(date)) is not None:
            origin = ordinal if origin is None else origin
            moments[row] = (ordinal - origin) * DAY_NS + clock_ns
            continue
        if previous_ns >= 0:
            falls = clock_ns < previous_ns
            if date != days and not falls:
                raise ValueError(
                    f"{place(row)}: {date!r} comes after {days!r}, but the time of day does not "
                    "fall: write dates as YYYY-MM-DD"
                )
            day += falls and (date != days or previous_ns - clock_ns > DAY_NS // 2)
        days, previous_ns = date, clock_ns
        moments[row] = day * DAY_NS + clock_ns
    known = moments[~blank]
    if not form:
        _check_clock(cells[~blank], np.flatnonzero(~blank), known, place)
    seconds: Array = (moments - (known[0] if known.size else 0)) / NS
    seconds[blank] = np.nan
    return seconds


def _check_clock(
    cells: NDArray[Any],
    rows: NDArray[np.intp],
    times: NDArray[np.int64],
    place: Callable[[int], str],
) -> None:
    """Raise `ValueError` where a clock was changed, or counts twelve hours."""
    zones = [match[0] if (match := _ZONE.search(str(cell).strip())) else "" for cell in cells]
    if len(set(zones)) > 1 and not any(zone[0] in "+-Z" for zone in zones if zone):
        k = next(k for k, zone in enumerate(zones) if zone != zones[0])
        raise ValueError(
            f"{place(int(rows[k]))}: the zone changes from {zones[0]!r} to {zones[k]!r}: write it "
            "as in +01:00"
        )
    steps = np.diff(times)
    if not len(steps) or (zones[0] and zones[0][0] in "+-Z"):
        return
    period = abs(float(np.median(steps)))
    for size, why in (
        (HOUR_NS, "by an hour: does summer time begin or end? Write times with their zone, +01:00"),
        (12 * HOUR_NS, "back by half a day: is AM or PM missing? Write hours from 0 to 23"),
    ):
        jumps = np.flatnonzero(np.abs(np.abs(steps) - size) <= 3.0 * period)
        jumps = jumps[(steps[jumps] < 0) | (size == HOUR_NS)]
        if jumps.size and period < HOUR_NS / 60:
            raise ValueError(f"{place(int(rows[jumps[0] + 1]))}: the time jumps {why}")


def _parse(text: str, form: str) -> tuple[str, int]:
    """Return date, as it is written, and time of day [ns]; `ValueError`."""
    if form:
        moment = datetime.datetime.strptime(text, form)
        seconds = (moment.hour * 60 + moment.minute) * 60 + moment.second
        return moment.strftime("%Y-%m-%d"), seconds * NS + moment.microsecond * 1000
    match = _MOMENT.fullmatch(text)
    if match is None:
        raise ValueError(text)
    hour, minute, second = (int(match[part]) for part in ("hour", "minute", "second"))
    if match["half"]:
        hour = hour % 12 + 12 * (match["half"][0] in "Pp")
    if hour > 24 or minute > 59 or second > 60:
        raise ValueError(text)
    offset = 0
    if (zone := match["zone"]) and zone[0] in "+-":
        offset = int(zone[0] + "1") * (int(zone[1:3]) * 60 + int(zone[3:].strip(":") or "0"))
    nanoseconds = int((match["fraction"] or "0").ljust(9, "0"))
    hour += 24 * int(match["days"] or 0)  # a time difference of pandas
    date = match["date"] or ""
    return date, ((hour * 60 + minute - offset) * 60 + second) * NS + nanoseconds


def _to_ordinal(date: str) -> int | None:
    """Return the day of a date that begins with the year, None of any other."""
    parts = re.split(r"[-/.]", date)
    if len(parts) != 3 or len(parts[0]) != 4:
        return None
    return datetime.date(*map(int, parts)).toordinal()
