"""Bad tables, configs, recordings and command lines, drawn by seed."""

import gzip
import io
import math
import random
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from teleop.link import ReceivedMessage
from teleop.messages.messages import MAX_TENDONS, TendonState
from teleop.messages.topics import TENDONS, TOPICS
from teleop.recording.writer import RecordConfig, RecordingWriter
from tests.teleop.recorded import SENDER, START_NS, heard

CONFIGS = sorted((Path(__file__).parents[2] / "configs").glob("*.yaml"))
CELLS = (
    "", " ", "nan", "inf", "-inf", "1e309", "-1e308", "1,5", "oops", "None", "0x10", "1_0", "\x00",
    "9" * 400, "٣", "12:30", "true", '"', "''", "-0.0", "5e-324", "1e5", "-40", "=1+1",
)  # fmt: skip
SCALARS = (
    "null", ".nan", ".inf", "-.inf", "-1", "0", "1e300", "1e-300", "9" * 5000, "''", "[]", "{}",
    "[1, 2]", "{type: nothing}", "!!python/object:os.system x", "2026-01-01", "&a [*a]", "*b",
    "'\\0'", "true", "\u2028", "~", "012", "1:30", "no", "simulated",
    "{a: {b: {c: 1}}}", "- x", "\t", "%",
    "0.5", "/", "../../etc/passwd", "x.yaml", "1.0e6", "300",
)  # fmt: skip
NUMBERS = (
    "0", "-1", "nan", "inf", "1e999", "1e-300", "0.01", "1", "x", "", "0.5", "1e5", "9" * 400,
)  # fmt: skip
COLUMNS = (
    "time_s", "proximal_tension_N", "proximal_displacement_m", "distal_tension_N",
    "distal_displacement_m",
)  # fmt: skip


class Case(NamedTuple):
    """A command line, and the files that it may write."""

    words: list[str]
    outputs: tuple[Path, ...] = ()
    refused: bool = False  # whether only exit code 2 is right


class Fuzz:
    """Draws cases into a folder; the same seed draws the same."""

    def __init__(self, seed: int, folder: Path) -> None:
        self.random, self.folder = random.Random(seed), folder  # noqa: S311
        self.numbers = np.random.default_rng(seed)

    def draw(self) -> Case:
        """Return a case; its files are in the folder."""
        kinds = (self.table, self.table, self.table, self.config, self.recording, self.words)
        return self.random.choice(kinds)()

    def pick(self, *of: str) -> str:
        return self.random.choice(of)

    # tables

    def table(self) -> Case:
        path = self._table_file()
        out = self.folder / self.pick(
            "out.csv", "out.csv", "out.csv.gz", "out.parquet", "out.txt", "data.csv"
        )
        saved = self.folder / self.pick("sheath.yaml", "sheath.yaml", "sheath.yaml", path.name)
        model = "slave.tendons=[{effective_friction: 0.5}]"
        words = self.random.choice(
            [
                ["estimate", path, "--set", model],
                ["estimate", path, "--set", model, "--out", out],
                ["estimate", path, "--set", model],
                ["estimate", path, "--set", model, "--drop-nonfinite", "--out", out],
                ["estimate", path, "--fit"],
                ["estimate", path, "--fit", "--drop-nonfinite", "--save", saved],
                ["estimate", path, "--set", model, "--drop-nonfinite"],
                ["estimate", path, "--fit", "--save", saved],
                ["estimate", path, "--fit", "--blocked-tip"],
                ["estimate", path, "--set", model, "--tendon", self.pick("1", "2", "1b", "9", "")],
                ["estimate", path, "--set", model, "--column", f"time={self.pick(*COLUMNS, 'x')}"],
                ["estimate", path, "--model", path],
                ["estimate", path, "--calibration", path],
                ["diagnose", path, "--effects", "slack", "--column", "proximal_tension=absent"],
                ["pair", path, path, path],
            ]
        )
        return Case([str(word) for word in words], (out, saved))

    def _table_file(self) -> Path:
        rows = self.random.choice([0, 1, 2, 5, 19, 60, 90, 90, 90])
        time = np.arange(rows) * 0.01
        tension = 6.0 - 5.0 * np.cos(8.0 * time) + 0.01 * self.numbers.normal(size=rows)
        values = [time, tension, 1e-4 * tension, 0.4 * tension, 1e-5 * tension]
        columns = {
            name: list(map(repr, v.tolist())) for name, v in zip(COLUMNS, values, strict=True)
        }
        for _ in range(self.random.choice([0, 1, 1, 1, 2, 3])):
            self._spoil(columns)
        text = self._csv(columns)
        data, suffix = text.encode("utf-8", "surrogatepass"), ".csv"
        kind = self.random.random()
        if kind < 0.15:
            data, suffix = gzip.compress(data), ".csv.gz"
        elif kind < 0.3:
            data, suffix = self._parquet(columns), ".parquet"
        elif kind < 0.32:
            data = text.encode("utf-16")
        path = self.folder / f"data{suffix}"
        if self.random.random() < 0.05:
            path = self.folder / self.pick(
                "data.csv", "data.parquet", "data.mcap", "data.txt", "data"
            )
        if self.random.random() < 0.03:
            path.mkdir()
            return path
        path.write_bytes(self.damage(data) if self.random.random() < 0.15 else data)
        return path

    def _spoil(self, columns: dict[str, list[str]]) -> None:
        name = self.pick(*columns)
        cells, kind = columns[name], self.random.randrange(14)
        row = self.random.randrange(len(cells)) if cells else 0
        if kind == 0 and len(columns) > 1:
            del columns[name]
        elif kind == 1:
            columns[self.pick("", "time", name + "m", "proximal_torque_Nm", "é\n", "a,b")] = (
                columns.pop(name)
            )
        elif kind <= 4 and cells:
            cells[row] = self.pick(*CELLS)
        elif kind == 5:
            self.random.shuffle(cells)
        elif kind == 6:
            factor = self.random.choice([0.0, -1.0, 1e3, 1e-12, 1e300, math.nan])
            columns[name] = [self._times(cell, factor) for cell in cells]
        elif kind == 7 and cells:
            columns[name] = cells[:1] * len(cells)
        elif kind == 8:
            columns[name] = [self.pick(*CELLS) for _ in cells]
        elif kind <= 10 and cells:
            cells[row] = self.pick("900", "-3", "1e-9", "0", "60", "1e5")
        elif cells:
            factor = self.random.choice([9.8, 0.1, 100.0, 1e3, 1e-3, -1.0, 0.0])
            columns[name] = [self._times(cell, factor) for cell in cells]

    @staticmethod
    def _times(cell: str, factor: float) -> str:
        try:
            return repr(factor * float(cell))
        except ValueError:
            return cell

    def _csv(self, columns: dict[str, list[str]]) -> str:
        between = self.random.choice([*[","] * 30, ";", "\t", ", ", ",,"])
        end = self.random.choice([*["\n"] * 8, "\r\n", "\r", "\n\n"])
        lines = [between.join(columns)] * self.random.choice([*[1] * 20, 0, 2])
        lines += [between.join(cells) for cells in zip(*columns.values(), strict=True)]
        if len(lines) > 1 and self.random.random() < 0.1:
            row = self.random.randrange(len(lines))
            lines[row] += self.pick(",", ",1", '"', "\x00", " #")
        return end.join(lines) + self.random.choice([end, ""])

    def _parquet(self, columns: dict[str, list[str]]) -> bytes:
        arrays = {}
        for name, cells in columns.items():
            try:
                arrays[name] = pa.array([float(cell) for cell in cells])
            except ValueError:
                arrays[name] = pa.array([c.encode("utf-8", "replace").decode() for c in cells])
        file = io.BytesIO()
        parquet.write_table(pa.table(arrays), file)
        return file.getvalue()

    def damage(self, data: bytes) -> bytes:
        """Return bytes that are cut, changed, doubled, filled up, or numbers made large."""
        at = self.random.randrange(len(data) + 1)
        kind, changed = self.random.randrange(7), bytearray(data)
        if kind == 0:
            return data[:at]
        if kind == 1:
            return data[:at] + self.random.randbytes(self.random.randint(1, 40)) + data[at:]
        if kind == 2:
            return data[:at] + bytes(self.random.randint(1, 400))
        if kind == 3:
            return data[at:]
        if kind == 4:
            changed[at : at + 8] = (1 << self.random.choice([20, 31, 33, 62])).to_bytes(8, "little")
            return bytes(changed)
        for _ in range(self.random.randint(1, 20) if changed else 0):
            changed[self.random.randrange(len(changed))] ^= 1 << self.random.randrange(8)
        return bytes(changed)

    # configs

    def config(self) -> Case:
        path = self.folder / "config.yaml"
        text = self.random.choice(CONFIGS).read_text()
        for _ in range(self.random.randint(1, 4)):
            text = self._spoil_lines(text)
        data = text.encode("utf-8", "surrogatepass")
        path.write_bytes(self.damage(data) if self.random.random() < 0.15 else data)
        out = self.folder / "out.csv"
        simulate = ["simulate", str(path), "--duration", "0.005", "--out", str(out)]
        return Case(simulate if self.random.random() < 0.3 else ["load", str(path)], (out,))

    def _spoil_lines(self, text: str) -> str:
        lines = text.splitlines() or [""]
        k, kind = self.random.randrange(len(lines)), self.random.randrange(8)
        if kind <= 3:
            key, colon, _ = lines[k].partition(":")
            lines[k] = f"{key}{colon} {self.pick(*SCALARS)}"
        elif kind == 4:
            del lines[k]
        elif kind == 5:
            lines.insert(k, self.random.choice(lines))
        elif kind == 6:
            lines[k] = self.pick(" ", "\t", "- ", "? ", "{") + lines[k]
        else:
            deep = self.random.choice([3, 200, 5000])
            lines[k] += self.pick("[" * deep, "{a: " * deep, "# " + "x" * deep, "!" * deep)
        return "\n".join(lines)

    # recordings

    def recording(self) -> Case:
        path = self.folder / "run.mcap"
        path.write_bytes(self.damage(recording_bytes(self.folder, self.random)))
        out = self.folder / self.pick("bag", "out.csv", "run.mcap")
        model = "slave.tendons=[{effective_friction: 0.5}]"
        words = self.random.choice(
            [
                ["estimate", path, "--set", model],
                ["estimate", path, "--set", model, "--drop-nonfinite", "--out", out],
                ["recordings", "to-ros2", path, "--out", out],
                ["recordings", "to-ros2", path, "--out", out, "--rate", self.pick(*NUMBERS)],
                ["recordings", "to-table", path, "--out", out, "--to", self.pick(*NUMBERS)],
                ["recordings", "to-table", path, "--out", out, "--rate", self.pick(*NUMBERS)],
                ["recordings", "to-lerobot", path, "--out", out, "--task", "x", "--marks", "e"],
                ["view", path, "--view", "none", "--duration", "0.1"],
                ["diagnose", path, "--effects", "slack"],
                ["replay", path, "--speed", "0"],
            ]
        )
        return Case([str(word) for word in words], (out,))

    # command lines

    def words(self) -> Case:
        data = self.folder / "data.csv"
        data.write_text("time_s,proximal_tension_N\n0,1\n0.01,2\n")
        out = self.folder / self.pick("data.csv", "new.csv", "x.foo", ".", "no/x.csv", "a\nb.csv")
        number = self.pick(*NUMBERS)
        command = self.random.choice(COMMANDS)
        known = [
            ["--out", str(out)], ["--json", str(out)], ["--force"], ["--set", self.pick(*SETTINGS)],
            ["--set", f"slave.rig.joints={self.pick(*SCALARS)}"],
            *([f"--{name}", number] for name in OPTIONS.get(command[0], ())),
        ]  # fmt: skip
        other = [
            ["--save", str(out)], ["--figure", str(out)], ["--column", "time="], ["--fit"], [""],
            ["--joint", number], ["--jobs", number], ["--view", str(out)], [str(data)],
            ["--calibration", str(data)], ["--config", str(data)], ["--sheaths", number],
            ["--noise", f"proximal_tension={number}"], ["--model", f"1a={data}"], ["--side", "c"],
        ]  # fmt: skip
        options = self.random.sample(known, 2)
        options += self.random.sample(other, 1) if self.random.random() < 0.4 else []
        words = [word for option in options for word in option]
        if command[0] == "estimate":
            words = [str(data), *words]
        if command[0] == "simulate" and self.random.random() < 0.8:
            words = [*words, "--out", str(self.folder / "new.csv")]
            out = self.folder / "new.csv"
        # nothing runs for long: what could is told to end at once, or is refused
        ending = ENDING.get(" ".join(command), ["--no-such-option"])
        return Case([*command, *words, *ending], (out,))


COMMANDS = (
    *[["simulate"]] * 8, *[["estimate"]] * 4, ["diagnose"], ["pair"], ["calibrate"], ["run"],
    ["slave"], ["master"], ["record"], ["view"], ["ros"], ["impair"], ["replay"], ["set"],
    ["recordings", "to-ros2"], ["recordings"], ["devices", "dump"], ["devices"], ["rig", "scan"],
    ["stop"], ["bench"], ["bench", "paper"], ["doctor"], [""],
)  # fmt: skip
OPTIONS = {
    "simulate": ("seed", "rate", "peak", "speed", "stroke", "period", "keep", "profile"),
    "estimate": ("length", "tendon", "rig"),
    "diagnose": ("effects", "cause", "tendon"),
}
SETTINGS = (
    "x", "a=", "slave.rig=1", "slave.gate.speed_max=9", "=", "a.b=[", "slave.rig.period=1e-9",
    "slave.tendons=[{effective_friction: 0.5}]", "slave.rig.seed=-1", "slave.calibration=as-built",
    "slave.rig.effects=[{type: slack}]", "slave.rig.period=0.1", "slave.tendons=[]", "session=",
    "slave.rig.joints.0.tendons.0.sheath.friction=1e9", "slave.rig={type: replayed, file: .}",
)  # fmt: skip
ENDING = {"simulate": ["--duration", "0.01"], "estimate": [], "diagnose": [], "pair": []}


def _session(k: int) -> list[ReceivedMessage]:
    """Return what a slave sends at tick k."""
    tension, stamp_ns = 6.0 - 5.0 * math.cos(0.08 * k), START_NS + k * 1_000_000

    def all_tendons(value: float) -> tuple[float, ...]:
        return (value, *(math.nan,) * (MAX_TENDONS - 1))

    message = TendonState(
        tendons=1,
        time_s=1e-3 * k,
        proximal_tension=all_tendons(tension),
        proximal_displacement=all_tendons(1e-4 * tension),
        bench_distal_tension=all_tendons(0.4 * tension),
        bench_distal_displacement=all_tendons(1e-5 * tension),
    )
    data = message.pack(SENDER, k, stamp_ns)
    return [ReceivedMessage(TENDONS, data, stamp_ns, SENDER, k, stamp_ns)]


_KEPT: dict[Path, bytes] = {}


def recording_bytes(folder: Path, draw: random.Random) -> bytes:
    """Return a short whole recording; made once."""
    if not _KEPT:
        rng = np.random.default_rng(1)
        made = folder / "made"
        config = RecordConfig(directory=str(made))
        for of in (_session, lambda k: [heard(topic, k, rng) for topic in TOPICS]):
            with RecordingWriter(config, "fuzz", START_NS, "", ()) as writer:
                for k in range(1, 90):  # fewer than a diagnosis takes, which would be long
                    writer.write(of(k), START_NS + k * 1_000_000)
            _KEPT[writer.path] = writer.path.read_bytes()
            writer.path.unlink()
        made.rmdir()
    return draw.choice(list(_KEPT.values()))
