"""Whether samples can be those of a tendon, in the units in which they were read."""

import math
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np

from estimator.array_types import Array
from estimator.units import LINEAR, Units
from teleop.data import standard_columns
from teleop.data.column_units import PERIOD_MIN, propose_length_unit, propose_time_unit
from teleop.data.raw_table import RawTable
from teleop.data.run_splitting import is_overflow
from teleop.data.text_cells import THOUSANDS
from teleop.errors import UsageError

TENSION_PEAK = 1000.0  # [N] above this the unit is wrong: grams or millinewtons
TRAVEL_SPAN = 2.0  # [m] above this the unit is wrong: millimetres
TORQUE_PEAK = 1000.0  # [N m] above this the unit is wrong: N mm
ANGLE_SPAN = 30.0  # [rad] above this, five turns, the unit is wrong: degrees
# [s] above this the unit is wrong, unless it is told: milliseconds of 2 kHz are 0.5
PERIOD_MAX = 0.4
# [s] below PERIOD_MIN likewise, or of so short a record whose name states another unit than s
SHORT_PERIOD, SHORT_DURATION = 2.1e-4, 2.0
LONG_PERIOD, LONG_DURATION = 0.02, 3600.0  # [s] a record of so long may be one of milliseconds
COUNTER_PERIODS = 100  # back by as many may be the overflow of a counter
SPEED_ROWS = 20  # samples from which on a speed tells
# [m/s], [rad/s] as tendons and motors are moved; slower ones are asked about at 50 Hz or less
SPEED_RANGES = {"m": (2.5e-4, 2.0), "rad": (0.025, 2000.0)}
NOISE_FLOOR = 0.1  # [N] tolerated reading below zero ...
NOISE_SHARE = 0.02  # ... plus this fraction of the peak (zero error)
ZERO_SHARE = 0.25  # of its peak, where a wrong zero is identified or only scored


def check_samples(
    raw: RawTable,
    names: Mapping[str, str],
    numbers: Mapping[str, Array],
    zero_errors: Collection[str],
    diagnosed: bool,
    units: Units,
    stated: Collection[str],
    factors: Mapping[str, tuple[str, float]],
) -> None:
    """Check for increasing time, plausible units and non-negative tensions; some may be missing.

    The units of `stated` items are by the option, so their sizes are right; `factors` are the units
    and their sizes by column.
    """
    name = names["time"]
    unit = factors[name][0] or "s"
    remedy = f"name the unit, --column 'time={name}[UNIT]', or [{unit}] if it is right"
    asks = unit in ("ms", "us", "µs", "ns") and "proximal_displacement" not in names
    asked = "" if "time" in stated else remedy
    check_time(raw, name, numbers[name], asked, *factors[name], asks_if_brief=asks)
    channels = {item: numbers[name] for item, name in names.items() if item != "time"}
    _check_common_rows(raw.path, names, channels)
    for item in ("proximal_tension", "distal_tension"):
        if item in names:
            option = standard_columns.STANDARD_NAMES[units][item].rpartition("_")[0]
            loop = f"; a closed loop's forces are named {item.replace('tension', 'force')}_N"
            check_effort(
                raw,
                names[item],
                numbers[names[item]],
                units,
                may_err=item in zero_errors,
                option=option,
                any_size=item in stated,
                remedy=loop * diagnosed,
            )
    span_max = ANGLE_SPAN if units.rotary else TRAVEL_SPAN
    for item in ("proximal_displacement", "distal_displacement"):
        if item not in names or factors[names[item]][0] == "rev":  # of which there may be many
            continue
        travel, name = numbers[names[item]], names[item]
        if (span := float(np.nanmax(travel) - np.nanmin(travel))) > span_max and item not in stated:
            row = int(np.nanargmax(np.abs(travel)))
            fault = f"travel spans {span:.6g} m: is it in metres, not mm?"
            option, other, unit = item, propose_length_unit(span / factors[name][1]), "m"
            if units.rotary:
                fault = f"angle spans {span:.6g} rad: degrees, or {span / math.tau:.1f} turns?"
                option, other, unit = item.replace("displacement", "angle"), "deg", "rad"
            unit = factors[name][0] or unit
            raise UsageError(
                f"{raw.locate(name, row)}: {fault}"
                f"{_explain_sentinel(float(travel[row]))} Name the unit, "
                f"--column '{option}={name}[{other}]', or [{unit}] if it is right"
            )
    if "time" not in stated and "proximal_displacement" in names:
        clock, travel = names["time"], numbers[names["proximal_displacement"]]
        _check_speed(raw, clock, numbers[clock], travel, units, remedy, *factors[clock])


def _check_common_rows(path: Path, names: Mapping[str, str], channels: Mapping[str, Array]) -> None:
    """Raise `UsageError` if rows of several sources alternate, so that none has two channels."""
    known = {item: np.isfinite(values) for item, values in channels.items()}
    first, *others = known
    for item in others:
        if not (known[first] & known[item]).any():
            raise UsageError(
                f"{path}: no row has both {names[first]!r} and {names[item]!r}: rows of several "
                "sources alternate; interpolate them at the same times"
            )


def _check_speed(
    raw: RawTable,
    name: str,
    time: Array,
    travel: Array,
    units: Units,
    remedy: str,
    unit: str,
    factor: float,
) -> None:
    """Raise `UsageError` for a motion that no tendon makes in such times [s]."""
    known = np.flatnonzero(np.isfinite(travel))
    if len(known) < SPEED_ROWS:
        return
    rows = np.arange(2, len(known) - 2, max(len(known) // 100, 1))
    around = known[rows[:, None] + np.arange(-2, 3)]  # of five samples a spike is not the median
    steps = np.abs(np.diff(np.median(travel[around], axis=1))) / np.diff(time[known[rows]])
    fastest, period = float(steps.max()), float(np.median(np.diff(time)))
    slowest, limit = SPEED_RANGES[units.travel]
    if fastest > limit or (0.0 < fastest < slowest and period > LONG_PERIOD):
        raise UsageError(
            f"{raw.locate(name, 0)}: the drive moves at {fastest:.3g} "
            f"{units.travel}/s at most: is the unit of time right? Else "
            + _name_unit(remedy, period / factor, unit, slower=fastest > limit)
        )


def _name_unit(remedy: str, period: float, unit: str, *, slower: bool) -> str:
    """Return a remedy with the unit that is shorter than a wrong one, or longer if `slower`."""
    return remedy.replace("[UNIT]", f"[{propose_time_unit(period, unit or 's', slower=slower)}]")


def check_time(
    raw: RawTable,
    name: str,
    time: Array,
    remedy: str,
    unit: str = "s",
    factor: float = 1.0,
    *,
    asks_if_brief: bool = False,
) -> None:
    """Raise `UsageError` unless times [s] increase, at a rate at which tendons are measured.

    Without a `remedy` the unit is known, and any rate is right. In the file times are in `unit`, of
    `factor` seconds. A fast and brief record may be one of seconds if no travel tells the speed.
    """
    periods = np.diff(time)
    if (late_rows := np.flatnonzero(periods <= 0.0)).size:
        row = int(late_rows[0]) + 1
        location = raw.locate(name, row)
        back = f"time goes back from {float(time[row - 1]):.6g} to {float(time[row]):.6g}"
        restarts = time[row] < time[0] + 0.1 * (time[row - 1] - time[0])
        period, step = float(np.median(np.abs(periods))), float(time[row - 1] - time[row])
        if step > COUNTER_PERIODS * period and is_overflow(step + period, period):
            raise UsageError(
                f"{location}: {back}: the counter begins anew, but time must increase: add "
                f"{step + period:.10g} s from there on, or split the file there"
            )
        if restarts and row > 1 and raw.place(row).startswith("line "):
            line = int(raw.place(row).removeprefix("line "))
            raise UsageError(
                f"{raw.path}: line {line}: a second record begins here ({back}); split the file: "
                f"`head -n {line - 1} {raw.path.name} > first{raw.path.suffix}`, and the rest "
                "likewise below its names (`teleop diagnose` takes several files)"
            )
        fault = f"{float(time[row])!r} does not come after {float(time[row - 1])!r}"
        hint = (
            " (a recording: was the slave restarted there?)" if raw.path.suffix == ".mcap" else ""
        )
        remedy = ""
        if (equal := int((periods == 0.0).sum())) > SPEED_ROWS:
            rate = f"{estimate_rate(time):.4g}".replace("nan", "HZ")
            remedy = f"; {equal} are equal: evenly spaced samples need no time, but --rate {rate}"
            if column := _find_device_column(raw):
                remedy = f"; column {column!r} names devices in turn: keep the rows of one"
        raise UsageError(f"{location}: {fault}{hint}; time must increase from row to row{remedy}")
    if not remedy or not periods.size:
        return
    median, duration = float(np.median(periods)), float(time[-1] - time[0])
    if median > PERIOD_MAX or (median > LONG_PERIOD and duration > LONG_DURATION):
        raise UsageError(
            f"{raw.locate(name, 1)}: samples are {median:.6g} s apart, "
            f"{duration:.6g} s in all: milliseconds, or sample numbers? Then "
            f"{_name_unit(remedy, median / factor, unit, slower=False)}; of sample numbers give "
            "the rate, --rate HZ"
        )
    brief = asks_if_brief and median < SHORT_PERIOD and duration < SHORT_DURATION
    if (brief or median < PERIOD_MIN) and len(periods) >= SPEED_ROWS:
        raise UsageError(
            f"{raw.locate(name, 1)}: samples are {median:.3g} s apart, "
            f"{duration:.3g} s in all, faster than tendons are measured: seconds, minutes, "
            f"hours or days? Then {_name_unit(remedy, median / factor, unit, slower=True)}"
        )


def estimate_rate(time: Array) -> float:
    """Return the rate [Hz] of samples whose clock is coarse, by its whole ticks; NaN below two."""
    ticks = np.flatnonzero(np.diff(time) > 0.0) + 1
    if len(ticks) < 2:
        return math.nan
    return float((ticks[-1] - ticks[0]) / (time[ticks[-1]] - time[ticks[0]]))


def _find_device_column(raw: RawTable) -> str:
    """Return the column that repeats some different values from row to row, "" if there is none."""
    for name, column in raw.columns.items():
        values = column[:SPEED_ROWS].tolist()
        period = values.index(values[0], 1) if values[0] in values[1:] else 0
        if 1 < period == len(set(values)) and (column[period:] == column[:-period]).all():
            return name
    return ""


def check_effort(
    raw: RawTable,
    name: str,
    effort: Array,
    units: Units = LINEAR,
    *,
    may_err: bool = False,
    option: str = "",
    any_size: bool = False,
    remedy: str = "",
) -> None:
    """Raise `UsageError` for a tension or torque that is too large, or a tension that pushes.

    With `may_err` the cell's zero may be off, and single samples low. NaN where one is missing.
    The unit can be given by `--column` as that of `option`, if it is one; then `any_size` is right.
    """
    row = int(np.nanargmax(np.abs(effort)))
    low = int(np.nanargmin(_remove_dips(effort) if may_err else effort))
    peak = float(effort[row])
    if abs(peak) > (TORQUE_PEAK if units.rotary else TENSION_PEAK) and not any_size:
        what, other, si = "tendon tension in newtons", "mN", "N"
        if units.rotary:
            what, other, si = "torque in newton metres", "Nmm", "Nm"
        how = "; check the unit"
        if option:
            gram = " or [gf]" * (other == "mN")
            how = f"; name the unit, --column '{option}={name}[{other}]'{gram}, or [{si}] if it is"
            how += " right"
        grouped = " (its thousands separators are read as such)"
        how = grouped * (THOUSANDS in raw.words.get(name, ())) + how
        raise UsageError(
            f"{raw.locate(name, row)}: {peak:.6g} is too large for a {what}"
            f"{_explain_sentinel(peak)}{how}; or remove the spike"
        )
    if units.signed:
        return
    share = ZERO_SHARE if may_err else NOISE_SHARE
    floor = NOISE_FLOOR + share * float(np.nanmax(effort, initial=0.0))
    if effort[low] < -floor:
        cause = "a zero offset" if may_err else "noise"
        hint = f", --column '{option}={name}[N, zero {effort[low]:.3g}]' or [-1 N]" * (option != "")
        fault = (
            f"{float(effort[low]):.6g} N: a tendon cannot push ({cause} is taken to end at "
            f"{-floor:.3g} N); correct its zero or its sign{hint}{remedy}"
        )
        fault += _explain_sentinel(float(effort[low]))
        raise UsageError(f"{raw.locate(name, low)}: {fault}")


def _explain_sentinel(value: float) -> str:
    """Return a hint at a number that loggers write for a missing value."""
    digits = f"{abs(value):.0f}"
    is_sentinel = abs(value) > 1e30 or (digits.strip("9") == "" and len(digits) > 2)
    return f" (is {value:.6g} a missing value? leave it blank)" if is_sentinel else ""


def _remove_dips(signal: Array) -> Array:
    """Return a signal without isolated low samples; beside a missing one (NaN) none is isolated."""
    filled = signal.copy()
    lower = np.minimum(signal[:-2], signal[2:])
    filled[1:-1] = np.where(np.isnan(lower), signal[1:-1], np.maximum(signal[1:-1], lower))
    return filled
