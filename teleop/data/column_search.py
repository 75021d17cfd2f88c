"""Which columns of a file are the channels: found by their names, or asked for by `--column`."""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimator.units import LINEAR, Units
from teleop.config.suggestions import suggest_spelling
from teleop.data import standard_columns
from teleop.data.column_units import UNIT_FACTORS, propose_time_unit, states_unit
from teleop.data.raw_table import RawTable
from teleop.data.standard_columns import Columns
from teleop.data.table_parser import clean_name
from teleop.data.time_text import has_moments
from teleop.errors import UsageError

NAMES_SHOWN = 12  # of a file's columns in an error message
_OF_RAW_VALUES = (
    " (or 'proximal_torque=COLUMN[Nm]'; of amperes [0.05 Nm], of counts [0.002 N, zero 8060])"
)
_QUANTITY_WORDS = {
    "time": "time|timestamp|zeit|x_value|t",
    "tension": "tension|force|load|load_?cell|torque|effort|kraft",
    "displacement": "displacement|position|pos|travel|stroke|encoder|angle|weg|winkel",
}
_END_WORDS = {
    "proximal": "proximal|prox|in|inlet|input|housing",
    "distal": "distal|dist|out|outlet|output|tip",
}
_TENSION_AT_END = re.compile(r"(?i)(?<![a-z])[tf](?=_?(in|out)(?![a-z]))")  # T_in, Fout


def match_name(raw: RawTable, name: str) -> str:
    """Return a column's name as the file has it: as asked for, or cleaned."""
    return name if name in raw.columns or clean_name(name) not in raw.columns else clean_name(name)


def replace_aliases(columns: Columns, aliases: Mapping[str, str]) -> Columns:
    """Return names of which standard ones are those in the file, such as `time_ms`."""
    return replace(
        columns, **{k: aliases.get(name, name) for k, name in columns.list_names().items()}
    )


def detect_file_units(
    raw: RawTable,
    aliases: Mapping[str, str],
    tendons: Sequence[Columns],
    diagnosed: bool,
) -> Units:
    """Return the units of a file, as the names of its columns tell."""
    efforts = [columns.proximal_tension for columns in tendons]
    has_own_names = not all(columns.is_standard("proximal_tension") for columns in tendons)
    present = [*aliases, *(name for name in raw.columns if name not in aliases.values())]
    if not diagnosed and all(effort in present for effort in efforts):
        return LINEAR
    standard_columns.check_names(raw.path, present)
    if has_own_names:
        standard_columns.check_linear_names(
            raw.path, [n for c in tendons for n in c.list_names().values()]
        )
    units = (
        LINEAR
        if has_own_names
        else standard_columns.detect_units(
            raw.path, present, standard_columns.parse_tendon_number(efforts[0])
        )
    )
    if units.signed and not diagnosed:
        kind = "torque and angle" if units.rotary else "a force of either sign"
        raise UsageError(
            f"{raw.path}: has {kind}; only `teleop diagnose` reads these, here the tension of one "
            "tendon is needed (proximal_tension_N)"
        )
    return units


def is_travel_pair(raw: RawTable, columns: Columns) -> bool:
    """Return whether a file has both travels, and nothing that may be a tension."""
    names = columns.list_names()
    return (
        columns.is_standard("proximal_tension")
        and all(names[f"{end}_displacement"] in raw.columns for end in ("proximal", "distal"))
        and not _list_tensions(raw.columns)
    )


def _list_tensions(names: Iterable[str]) -> list[str]:
    is_tension = re.compile(_QUANTITY_WORDS["tension"], re.IGNORECASE)
    return [name for name in names if is_tension.search(name)]


def find_columns(
    raw: RawTable,
    columns: Columns,
    claimed: set[str],
    unstated: Mapping[str, str],
    required: Collection[str],
) -> dict[str, str]:
    """Return field -> column name of what the file has of `columns`."""
    columns_found = {}
    moments = {n: "s" for n, c in raw.columns.items() if c.dtype == object and has_moments(c)}
    units = dict(raw.units) | moments
    standard = {
        name for names in standard_columns.STANDARD_NAMES.values() for name in names.values()
    }
    unclaimed = [
        n
        for n in raw.columns
        if n not in claimed and standard_columns.strip_tendon_number(n) not in standard
    ]
    for item, name in columns.list_names().items():
        if name in raw.columns:
            columns_found[item] = name
            continue
        optional = item not in required and columns.is_standard(item)
        if raw.lacks and not optional:
            raise UsageError(f"{raw.path}: {raw.lacks}")
        if (unclear := unstated.get(name)) in unclaimed:
            what, unit = name.rpartition("_")[::2]
            rate = ""
            values = raw.columns[unclear]
            if item == "time" and values.dtype != object and len(values) > 1:
                period = float(np.nanmedian(np.diff(values)))
                unit = propose_time_unit(period) if period > 0.0 else unit
                size = UNIT_FACTORS["time"].get(unit, 0.0) * period
                rate = f" ({1.0 / size:.4g} Hz)" if size > 0.0 else ""
            raise UsageError(
                f"{raw.path}: column {unclear!r} states no unit that fits; say it: --column "
                f"'{what}={unclear}[{unit}]'{rate}{_ask_for_tension(item, columns, raw, unclaimed)}"
            )
        candidates = _list_tensions(unclaimed) if item == "proximal_tension" else []
        if len(candidates) > 1 and not optional:
            options = format_proposals(units, unclaimed)
            if "proximal_tension=" not in options:
                options = (
                    f"--column 'proximal_tension={candidates[0]}'; or an antagonistic pair: "
                    "teleop pair"
                )
            raise UsageError(
                f"{raw.path}: {' and '.join(candidates)}: say which is the tension at the housing: "
                f"{options}"
            )
        hint = suggest_spelling(name, unclaimed, cutoff=0.88 if optional else 0.6)
        advice = _explain_missing(item, units, unclaimed) + _ask_for_tension(
            item, columns, raw, unclaimed
        )
        if hint:
            asked = _ask_for_tension(item, columns, raw, unclaimed)
            advice = f"{hint} Then --column '{item}=COLUMN[UNIT]' says so{asked}"
        if hint or not optional:
            has = ", ".join(list(raw.columns)[:NAMES_SHOWN]) + ", ..." * (
                len(raw.columns) > NAMES_SHOWN
            )
            raise UsageError(f"{raw.path}: no column {name!r}{advice} (it has {has})")
    return columns_found


def _explain_missing(item: str, units: Mapping[str, str], names: Sequence[str]) -> str:
    """Return what to do about a column that must be there; those that may be it are proposed."""
    if item == "time":
        return f"; name it by --column '{_propose_column(item, units, names)}', or give --rate HZ"
    if item != "proximal_tension":
        return ""
    return (
        "; friction and force are only known from the tension at the housing: add a load cell, or "
        f"name its column by {_format_tension(units, names)}"
    )


def _ask_for_tension(item: str, columns: Columns, raw: RawTable, names: Sequence[str]) -> str:
    """Return the options for what is missing too, for the message on the time."""
    if item != "time" or columns.proximal_tension in raw.columns:
        return ""
    return f"; and the tension: {_format_tension(raw.units, names)}"


def _format_tension(units: Mapping[str, str], names: Sequence[str]) -> str:
    """Return the option for the tension at the housing, and for what else the names tell."""
    options = format_proposals(units, names)
    if "proximal_t" in options:
        return options
    return " ".join(
        filter(None, (f"--column 'proximal_tension=COLUMN[UNIT]'{_OF_RAW_VALUES}", options))
    )


def format_proposals(
    units: Mapping[str, str], names: Sequence[str], known: Collection[str] = ()
) -> str:
    """Return the options for channels that columns may be by their names, "" for none.

    `units` are those of a row below the names, by column; `known` are channels not to be proposed.
    """
    items = [f"{end}_{what}" for what in ("tension", "displacement") for end in _END_WORDS]
    proposed = (_propose_column(item, units, names) for item in items if item not in known)
    return " ".join(f"--column '{each}'" for each in proposed if "=COLUMN" not in each)


def _propose_column(item: str, units: Mapping[str, str], names: Sequence[str]) -> str:
    """Return the option for a channel, with the column that may be it, if there is one.

    Names tell the end or none; one that tells none may be that at the housing.
    """
    end, _, quantity = item.rpartition("_")
    close = [name for name in names if _names_quantity(name, quantity)]
    if end:
        at_end = [name for name in close if _has_word(name, _END_WORDS[end])]
        ends = "|".join(_END_WORDS.values())
        open_names = [name for name in close if not _has_word(name, ends)]
        close = at_end or open_names * (end == "proximal")
    column = close[0] if len(close) == 1 else "COLUMN"
    item = item.replace("tension", "torque") if "torque" in column.lower() else item
    return f"{item}={column}" + "[UNIT]" * (not states_unit(column, units.get(column, "")))


def _names_quantity(name: str, quantity: str) -> bool:
    if _TENSION_AT_END.search(name):
        return quantity == "tension"
    return _has_word(name, _QUANTITY_WORDS[quantity]) and not re.search("(?i)pct|%", name)


def _has_word(name: str, words: str) -> bool:
    separated = _TENSION_AT_END.sub("t_", re.sub("(?<=[a-z])(?=[A-Z])", "_", name))
    return re.search(rf"(?i)(?<![^\W\d_])({words})(?![^\W\d_])", separated) is not None
