"""Figures of repeated runs: medians, their spread, ratios to a baseline and to an older result."""

from collections.abc import Iterable, Mapping, Sequence
from statistics import median
from typing import Any, NamedTuple


class Metric(NamedTuple):
    """One figure with its value in each run.

    `values` and those of the `baseline`, if there is one, have one number of each run;
    `higher_is_better` of rates, not of durations.
    """

    name: str
    unit: str
    values: tuple[float, ...]
    baseline: tuple[float, ...] = ()
    higher_is_better: bool = False

    @property
    def median(self) -> float:
        """Median of the values."""
        return median(self.values)

    @property
    def spread(self) -> float:
        """Range of the values."""
        return max(self.values) - min(self.values)

    @property
    def ratio(self) -> float | None:
        """Median of value over baseline of each run; None without a baseline or if it is zero."""
        pairs = list(zip(self.values, self.baseline, strict=False))
        return median(v / b for v, b in pairs) if pairs and all(b for _, b in pairs) else None


Row = dict[str, tuple[str, float | None, float | None, bool]]
"""Name of a figure -> unit, value, baseline, and whether higher is better."""


def collect_metrics(rows: Iterable[Row]) -> list[Metric]:
    """Return the figures of runs; a missing one (None) is omitted in its run."""
    values: dict[str, list[float]] = {}
    baselines: dict[str, list[float]] = {}
    kinds: dict[str, tuple[str, bool]] = {}
    for row in rows:
        for name, (unit, value, baseline, higher) in row.items():
            kinds[name] = unit, higher
            if value is not None:
                values.setdefault(name, []).append(value)
                if baseline is not None:
                    baselines.setdefault(name, []).append(baseline)
    return [
        Metric(name, unit, tuple(values[name]), tuple(baselines.get(name, ())), higher)
        for name, (unit, higher) in kinds.items()
        if name in values
    ]


def format_table(figures: Sequence[Metric]) -> list[str]:
    """Return a line for each figure: median, least and largest, baseline, ratio."""
    width = max(len(figure.name) for figure in figures)
    head = (
        f"{'':{width}}  {'median':>10} {'least':>10} {'largest':>10} {'baseline':>10} {'ratio':>7}"
    )
    return [head, *(_format_row(figure, width) for figure in figures)]


def _format_row(figure: Metric, width: int) -> str:
    numbers = [figure.median, min(figure.values), max(figure.values)]
    baseline = f"{median(figure.baseline):10.5g}" if figure.baseline else f"{'':10}"
    ratio = "" if figure.ratio is None else f"{figure.ratio:.2f}"
    shown = " ".join(f"{number:10.5g}" for number in numbers)
    return f"{figure.name:{width}}  {shown} {baseline} {ratio:>7}  {figure.unit}".rstrip()


def to_tree(figures: Sequence[Metric]) -> dict[str, Any]:
    """Return the figures as a tree for a file."""
    return {
        figure.name: {
            "unit": figure.unit,
            "median": figure.median,
            "values": list(figure.values),
            "baseline": list(figure.baseline),
            "ratio": figure.ratio,
            "higher_is_better": figure.higher_is_better,
        }
        for figure in figures
    }


def from_tree(tree: Mapping[str, Any]) -> dict[str, Metric]:
    """Return the figures of a file by name; `KeyError`, `TypeError` if it is invalid."""
    return {
        name: Metric(
            name,
            str(part["unit"]),
            tuple(map(float, part["values"])),
            tuple(map(float, part["baseline"])),
            bool(part["higher_is_better"]),
        )
        for name, part in tree.items()
        if part["values"]
    }


def format_comparison(new: Sequence[Metric], old: Mapping[str, Metric]) -> list[str]:
    """Return the changes of the figures as lines, with their significance.

    A change is significant if the medians differ by more than the larger spread.
    """
    common = [figure for figure in new if figure.name in old]
    if not common:
        return ["no figures in common with the older result"]
    width = max(len(figure.name) for figure in common)
    lines = [f"{'':{width}}  {'old':>10} {'new':>10} {'ratio':>7}"]
    counts = {"WORSE": 0, "better": 0, "": 0}
    for figure in common:
        old_value = old[figure.name]
        verdict = classify_change(figure, old_value)
        counts[verdict] += 1
        ratio = f"{figure.median / old_value.median:.2f}" if old_value.median else "-"
        lines.append(
            f"{figure.name:{width}}  {old_value.median:10.5g} {figure.median:10.5g} {ratio:>7}  "
            f"{verdict}".rstrip()
        )
    lines.append(
        f"{counts['WORSE']} worse and {counts['better']} better by more than the spread of the "
        f"runs, {counts['']} within that"
    )
    return lines


def classify_change(new: Metric, old: Metric) -> str:
    """Return WORSE or better if the medians differ by more than the larger spread, else nothing."""
    change = new.median - old.median
    if abs(change) <= max(new.spread, old.spread):
        return ""
    return "better" if (change > 0) == new.higher_is_better else "WORSE"
