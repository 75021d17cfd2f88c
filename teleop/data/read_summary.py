"""How a table was read, in one short form, which every report repeats."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimator.array_types import Array
from teleop.data.measured_table import MeasuredTable, Source
from teleop.data.standard_columns import STANDARD_NAMES

GAP_PERIODS = 1.5  # median periods from which on samples are missing
FILES_SHOWN = 6  # in a terminal, of many


@dataclass(frozen=True, slots=True)
class ReadSummary:
    """How a table was read."""

    file: str  # and which of its runs
    time: Array  # [s]
    channels: Mapping[str, tuple[Source, Array]]  # by name, `time` among them
    dropped: int = 0  # rows left out
    remarks: tuple[str, ...] = ()

    @classmethod
    def from_table(cls, table: MeasuredTable) -> "ReadSummary":
        """Return how a table of one tendon was read, its channels named as in its units."""
        named = {k: v.rpartition("_")[0] for k, v in STANDARD_NAMES[table.units].items()}
        channels = {
            named.get(item, item): (source, getattr(table, item))
            for item, source in table.sources.items()
        }
        return cls(table.name, table.time, channels, table.dropped, table.remarks)

    def to_json(self) -> dict[str, Any]:
        """Return it for programs, in SI units."""
        periods = np.diff(self.time)
        period = float(np.median(periods)) if periods.size else float("nan")
        gaps = np.flatnonzero(periods > GAP_PERIODS * period)
        return {
            "file": self.file,
            "samples": len(self.time),
            "dropped": self.dropped,
            "duration_s": float(np.ptp(self.time)),
            "rate_hz": 1.0 / period if periods.size else None,
            "gaps": len(gaps),
            "longest_gap_s": float(periods.max()) if gaps.size else 0.0,
            "channels": {
                name: source._asdict()
                | {"min": float(np.nanmin(values)), "max": float(np.nanmax(values))}
                | {"missing": int(np.isnan(values).sum())}
                for name, (source, values) in self.channels.items()
            },
            "remarks": list(self.remarks),
        }


def format_read_summary(reading: Mapping[str, Any]) -> str:
    """Return what `ReadSummary.to_json` says on one line, without the file's name."""
    rate = f", {reading['rate_hz']:.6g} Hz" if reading["rate_hz"] else ""
    parts = [f"{reading['samples']} samples, {reading['duration_s']:.6g} s{rate}"]
    if reading["dropped"]:
        parts.append(f"{reading['dropped']} rows left out")
    if reading["gaps"]:
        parts.append(f"{reading['gaps']} gaps, the longest {reading['longest_gap_s']:.4g} s")
    for name, channel in reading["channels"].items():
        unit = f" [{channel['unit']}]" * (channel["unit"] not in ("", "s", "N", "m", "Nm", "rad"))
        if unit or not channel["column"].startswith(name):
            parts.append(f"{name} from {channel['column']}{unit}")
        if channel["missing"]:
            parts.append(f"{channel['missing']} {name} missing")
    return "; ".join([*parts, *reading["remarks"]])


def format_read_summaries(readings: Sequence[Mapping[str, Any]]) -> str:
    """Return a line for each table, of many for the first, below a blank one."""
    lines = [f"read as: {each['file']}: {format_read_summary(each)}" for each in readings]
    if (more := len(lines) - FILES_SHOWN) > 0:
        lines[FILES_SHOWN:] = [f"read as: {more} files more, in the report"]
    return "\n".join(["", *lines])
