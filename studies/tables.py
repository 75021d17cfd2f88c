"""Write random tables as programs do, and count those that are read wrongly in silence.

  python -m studies.tables --count 2000 --seed 0

A table, of one run or several, is read as it was written, or refused with a reason; anything else
is wrong. Where the name of the time says seconds of milliseconds or microseconds, it must be
refused. Takes a minute for 2000.
"""

import contextlib
import io
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from studies.testbed.command import parse_options
from teleop.data.mapping_file import TableMapping, parse_column_options
from teleop.data.measured_table import read_runs
from teleop.errors import UsageError

ROWS = 30  # of a run
CHANNELS = ("time", "proximal_tension", "proximal_displacement")
UNITS = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0},
    "proximal_tension": {"N": 1.0, "mN": 1e-3, "kgf": 9.80665, "gf": 9.80665e-3, "lbf": 4.4482216},
    "proximal_displacement": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6},
}
DIGITS = {"s": 6, "ms": 3, "us": 0, "min": 9, "N": 4, "mN": 1, "kgf": 5, "gf": 2, "lbf": 4} | {
    "m": 7, "mm": 4, "cm": 5, "um": 1
}  # fmt: skip
MISSING = ("", "NaN", "N/A", "null", "--", "#N/A", "+OVLD", "#DIV/0!", "1.#QNAN")
MISSING += ("****", "-O.L", "Overflow", "1.#INF", "-1.#IND")
RUN_NAMES = ("run", "Trial", "trial_no", "File", "RunIndex", "episode")


@dataclass
class Written:
    """A table, and what it says."""

    data: bytes
    runs: list[dict[str, NDArray[np.float64]]]  # in SI units, times from the first
    columns: tuple[str, ...] = ()  # `--column`
    mapping: TableMapping = field(default_factory=TableMapping)
    must_be_refused: bool = False


def draw_motion(rng: Generator, time: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return a pull and release at a speed of tendons."""
    speed = rng.uniform(0.005, 0.2)  # [m/s]
    travel = rng.uniform(-0.01, 0.01) + speed / (2 * np.pi * 0.9) * np.sin(2 * np.pi * 0.9 * time)
    tension = rng.uniform(2.0, 80.0) * (1.2 + np.sin(5.0 * time + rng.uniform(0.0, 6.0)))
    return dict(zip(CHANNELS, (time, tension, travel), strict=True))


def draw_runs(rng: Generator) -> tuple[dict[str, NDArray[np.float64]], int, str]:
    """Return the samples of one run or several, how many runs, and what separates them."""
    rate = float(rng.choice([10, 20, 50, 100, 500, 1000, 2000, 5000]))
    count = int(rng.integers(2, 4)) if rng.random() < 0.2 else 1
    divided = str(rng.choice(["time", "names", "column"])) if count > 1 else ""
    restarts = divided == "time" or rng.random() < 0.5
    runs = [draw_motion(rng, np.arange(ROWS) / rate) for _ in range(count)]
    for k, run in enumerate(runs):
        run["time"] += 0.0 if restarts else k * (ROWS + int(rng.integers(0, 9))) / rate
    return {c: np.concatenate([run[c] for run in runs]) for c in CHANNELS}, count, divided


def write_table(rng: Generator) -> Written:
    """Return a random table."""
    values, count, divided = draw_runs(rng)
    rows = len(values["time"])
    separator = str(rng.choice([",", ";", "\t", "|", "  "]))
    decimal = "," if separator != "," and rng.random() < 0.4 else "."
    group = str(rng.choice([",", "'", "\u00a0"] if decimal == "." else [".", "'", "\u00a0"]))
    group = group if rng.random() < 0.25 and separator != "  " else ""
    group = "'" if group == separator else group
    style = str(rng.choice(["plain", "brackets", "suffix", "row", "own"]))
    units = {k: str(rng.choice(list(u))) for k, u in UNITS.items()}
    if style == "plain":
        units = {k: next(iter(u)) for k, u in UNITS.items()}
    cells, truth, moments = {}, {}, style != "row" and rng.random() < 0.25
    for name, unit in units.items():
        scaled = values[name] / UNITS[name][unit]
        digits = max(DIGITS[unit] - int(rng.integers(0, 2)) * (name != "time"), 0)
        scaled = np.round(scaled + (rng.integers(0, 1000) if name == "time" else 0), digits)
        text = [f"{x:{',' if group else ''}.{digits}f}" for x in scaled]
        if rng.random() < 0.15 and not group and name != "time":
            text = [f"{x:.9e}" for x in scaled]
        signs = {",": group, ".": decimal}
        if rng.random() < 0.1 and name != "time":
            signs["-"] = "−"
        plus = "+" * (rng.random() < 0.05)
        cells[name] = ["".join(signs.get(c, c) for c in each) for each in text]
        cells[name] = [each if each[0] in "-−" else plus + each for each in cells[name]]
        truth[name] = scaled * UNITS[name][unit]
    if moments:
        cells["time"], truth["time"] = write_moments(rng, values["time"], decimal)
        units["time"] = ""
    written = Written(b"", [])
    if style != "plain" and not moments and rng.random() < 0.1:
        written.must_be_refused = units["time"] in ("ms", "us")  # the name says seconds
        style, units["time"] = "suffix", "s" if written.must_be_refused else units["time"]
    if rng.random() < 0.3:
        word = str(rng.choice(MISSING))
        for row in rng.choice(rows, 3, replace=False):
            name = str(rng.choice(CHANNELS[1:]))
            cells[name][row], truth[name][row] = word, np.nan
    for part in range(count):
        run = {k: v[part * ROWS : (part + 1) * ROWS] for k, v in truth.items()}
        written.runs.append(run | {"time": run["time"] - run["time"][0]})
    names = build_names(rng, style, units)
    if style == "own":
        written.columns = tuple(f"{k}={n}" for k, n in names.items())
    order = [str(each) for each in rng.permutation(CHANNELS)]
    body = [[cells[name][row] for name in order] for row in range(rows)]
    head = [[decorate_name(rng, names[name]) for name in order]]
    if style == "row":
        head.append([f"[{units[n]}]" if rng.random() < 0.3 else units[n] for n in order])
    if rng.random() < 0.4:  # columns that nobody asked for
        head[0].append("note")
        head[1:] = [[*row, ""] for row in head[1:]]
        note = str(rng.choice(["ok", "Größe", "12", "x y"]))
        note = note.replace(" ", "") if separator == "  " else note
        body = [[*row, note] for row in body]
    if divided == "column":
        kind = str(rng.choice(["{}", "r{}", "run_{}.csv"]))
        head[0].append(str(rng.choice(RUN_NAMES)))
        head[1:] = [[*row, ""] for row in head[1:]]
        body = [[*row, kind.format(k // ROWS + 1)] for k, row in enumerate(body)]
    if separator == "  ":
        head = [[cell.replace(" ", "").replace("\u00a0", "") for cell in row] for row in head]
    if divided == "names":
        parts = [body[k : k + ROWS] for k in range(ROWS, rows, ROWS)]
        body = [*body[:ROWS], *(row for part in parts for row in (*head, *part))]
    written.data = assemble_file(rng, head, body, separator)
    return written


def write_moments(
    rng: Generator, time: NDArray[np.float64], decimal: str
) -> tuple[list[str], NDArray[np.float64]]:
    """Return times as text, and what they say [s]."""
    restarts = bool((np.diff(time) < 0.0).any())  # past midnight it would be a gap of a day
    begin = float(rng.choice([3600.0, 43_000.0, 86_399.5][: 3 - restarts]))
    form = str(
        rng.choice(["{iso}T{c}", "{c}", "{d}.3.2026 {c}", "{d}-Mar-2026 {c}", "3/{d}/2026 {h}"])
    )
    out = []
    for each in begin + np.round(time, 4):
        day, clock = divmod(float(each), 86_400.0)
        hour, rest = int(clock) // 3600, f"{int(clock) // 60 % 60:02d}:{clock % 60:07.4f}"
        rest = rest.replace(".", decimal)
        half = f"{(hour - 1) % 12 + 1}:{rest} {'AP'[hour // 12]}M"
        date = {"d": 9 + int(day), "iso": f"2026-03-{9 + int(day):02d}"}
        out.append(form.format(**date, c=f"{hour:02d}:{rest}", h=half))
    return out, np.round(time, 4)


def build_names(rng: Generator, style: str, units: dict[str, str]) -> dict[str, str]:
    """Return the columns' names."""
    names = {}
    for name, unit in units.items():
        spoken = name.replace("_", str(rng.choice([" ", "_", "-"]))).title()
        if style == "own":
            short = {"time": "t", "proximal_tension": "F", "proximal_displacement": "pos"}[name]
            names[name] = f"{short}[{unit}]" if unit else short
        elif style == "row" or not unit:
            names[name] = spoken if style == "row" else name
        elif style == "brackets":
            names[name] = f"{spoken} {rng.choice(['[{}]', '({})']).format(unit)}"
        else:
            names[name] = f"{name}_{unit}"
    return names


def decorate_name(rng: Generator, name: str) -> str:
    """Return a name with what programs put around it."""
    marks = ["{}", "{}", "{}", " {}", "{} ", "\u00a0{}", '"{}"']
    return str(rng.choice(marks)).format(name)


def assemble_file(
    rng: Generator, head: list[list[str]], body: list[list[str]], separator: str
) -> bytes:
    """Return the bytes of a file."""
    quoted = rng.random() < 0.15

    def quote(cell: str) -> str:
        inside = quoted or (separator.strip() in cell if separator.strip() else " " in cell.strip())
        return f'"{cell.strip(chr(34))}"' if inside else cell

    if separator == "  ":
        filler = [[cell or "-" for cell in row] for row in [*head[1:], *body]]
        head, body = [head[0], *filler[: len(head) - 1]], filler[len(head) - 1 :]
        quote = str  # type: ignore[assignment]
    lines = [separator.join(map(quote, row)) for row in [*head, *body]]
    above = [
        f"Bench{separator}3",
        "# recorded by nobody",
        f"Rate{separator}20 Hz",
        "Operator: A. Bee",
        "",
        f"Date{separator}2026-04-10",
    ]
    width = len(head[0])
    wide = [  # lines of text or numbers above the names, with as many cells
        ["Housing", *[""] * (width - 1)],
        [f"Gain {k}" for k in range(width)],
        [str(1.5 * k) for k in range(width)],
        ["s", *["N"] * (width - 1)],
    ]
    if rng.random() < 0.1:
        above = [separator.join(wide[int(rng.integers(0, 4))]), *above]
    lines = [*above[: int(rng.integers(0, 7)) if rng.random() < 0.4 else 0], *lines]
    if rng.random() < 0.05:
        lines[0] = f"# {lines[0]}"
    if rng.random() < 0.1:
        lines.insert(len(lines) - int(rng.integers(0, 20)), "")
    if rng.random() < 0.03:
        lines.append("End of data")
    if separator.strip() and rng.random() < 0.15:
        lines = [f"{line}{separator}" for line in lines]
    if separator in ",;" and rng.random() < 0.1:
        lines.insert(0, f"sep={separator}")
    end = str(rng.choice(["\n", "\r\n"]))
    text = end.join(lines) + end * int(rng.integers(0, 3))
    encoding = str(rng.choice(["utf-8", "utf-8", "utf-8-sig", "latin-1", "utf-16", "utf-16-le"]))
    return (text.replace("−", "-") if encoding == "latin-1" else text).encode(encoding)


def judge_table(written: Written, path: Path) -> tuple[str, str]:
    """Return "read", "refused" or "wrong", and why."""
    path.write_bytes(written.data)
    try:
        named = parse_column_options(written.columns)
        with contextlib.redirect_stderr(io.StringIO()):
            runs = read_runs(
                path, [named.names], diagnosed=True, units=named.units, mapping=written.mapping
            )
    except UsageError as error:
        return "refused", str(error).removeprefix(f"{path}: ")
    if written.must_be_refused:
        return "wrong", "a lie about the unit of time passed"
    if len(runs) != len(written.runs):
        return "wrong", f"{len(runs)} runs in place of {len(written.runs)}"
    for (table,), values in zip(runs, written.runs, strict=True):
        for name, truth in values.items():
            found = getattr(table, name)
            found = found - found[0] if name == "time" else found
            if found is None or len(found) != len(truth):
                return "wrong", f"{name} has other rows"
            if not np.allclose(found, truth, rtol=1e-9, atol=1e-9, equal_nan=True):
                return "wrong", f"{name} differs"
    return "read", ""


def read_tables(count: int, seed: int) -> tuple[Counter[str], list[tuple[int, str, str]]]:
    """Return how many were read, refused and wrong, and seed and reason of all but those read."""
    outcomes: Counter[str] = Counter()
    notes = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "x.csv"
        for number in range(seed, seed + count):
            outcome, why = judge_table(write_table(np.random.default_rng(number)), path)
            outcomes[outcome] += 1
            if outcome != "read":
                notes.append((number, outcome, why))
    return outcomes, notes


def main() -> None:
    args = parse_options(__doc__, count=(2000, "number of tables"), seed=(0, "of the first"))
    outcomes, notes = read_tables(args.count, args.seed)
    print(", ".join(f"{n} {outcome}" for outcome, n in outcomes.most_common()))
    reasons: dict[tuple[str, str], list[int]] = {}
    for number, outcome, why in notes:
        kind = "".join(c for c in why if not c.isdigit())[:90]
        reasons.setdefault((outcome, kind), []).append(number)
    for (outcome, why), seeds in sorted(reasons.items(), key=lambda each: -len(each[1])):
        print(f"{len(seeds):6} {outcome}: {why} (such as seed {seeds[0]})")


if __name__ == "__main__":
    main()
