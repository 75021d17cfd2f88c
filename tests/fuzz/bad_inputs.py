# ruff: noqa: E501, ARG005 - tables of bad bytes, and of functions of one signature

"""Inputs that must be refused, drawn by seed: tables, Parquet, recordings, bags and configs.

`python -m tests.fuzz.bad_inputs SEED FIRST END FOLDER` runs some of them in bounded memory, and
prints what was wrong, one line of JSON each.
"""

import contextlib
import gzip
import io
import json
import os
import random
import resource
import signal
import struct
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import lz4.frame
import numpy as np
import pyarrow as pa
import yaml
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC
from pyarrow import parquet

from teleop.cli import commands
from teleop.ros.message_types import (
    JOINT_STATE,
    VECTOR3,
    WRENCH,
    WRENCH_STAMPED,
    build_header,
    build_joint_state,
    build_message,
    encode,
)
from tests.fuzz.cases import COLUMNS, CONFIGS, Fuzz, recording_bytes
from tests.fuzz.running import HANG_CPU_S, HANG_S, check, contents, hang, load_all

MEMORY_MAX = 4_000_000_000  # [bytes] of address space, beyond what Python and its packages take; compiling takes 1
SECOND_NS = 1_000_000_000
MODEL = ("--set", "slave.tendons=[{effective_friction: 0.5}]")
NO_NUMBERS = ("oops", "1,5", "None", "0x10", "12:30", "true", "=1+1", "1 N", "--1", "1e", "N/A")


class BadInput(NamedTuple):
    """A command line on a bad input."""

    kind: str
    words: list[str]
    refused: bool = True  # with exit code 2; else it may be harmless, as a flipped bit is


class BadInputs:
    """Draws bad inputs into a folder; the same seed draws the same."""

    def __init__(self, seed: int, folder: Path) -> None:
        self.random, self.folder = random.Random(seed), folder  # noqa: S311
        self.fuzz = Fuzz(seed, folder)

    def draw(self) -> BadInput:
        """Return a bad input; its files are in the folder."""
        kinds: list[Callable[[], BadInput]] = [
            self.csv, self.csv, self.mutated_table, self.parquet, self.parquet, self.recording,
            self.recording, self.mutated_recording, self.bag, self.bag, self.mutated_bag,
            self.config, self.config, self.no_file,
        ]  # fmt: skip
        return self.random.choice(kinds)()

    def estimate(self, path: Path, *words: str) -> list[str]:
        return ["estimate", str(path), *MODEL, *words]

    # tables

    def table(self) -> dict[str, list[str]]:
        rows = self.random.randint(20, 90)
        time = 0.01 * np.arange(rows)
        tension = 6.0 - 5.0 * np.cos(8.0 * time)
        values = [time, tension, 1e-4 * tension, 0.4 * tension, 1e-5 * tension]
        return {name: list(map(repr, v.tolist())) for name, v in zip(COLUMNS, values, strict=True)}

    def csv(self) -> BadInput:
        kinds = [
            self._bad_cell, self._bad_number, self._bad_header, self._bad_rows, self._bad_time,
            self._bad_unit, self._too_large, self._bad_encoding,
        ]  # fmt: skip
        make = self.random.choice(kinds)
        columns = self.table()
        made = make(columns)
        text, words = made if isinstance(made, tuple) else (made, [])
        data = text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass")
        packed = self.random.random() < 0.3
        path = self.folder / ("data.csv.gz" if packed else "data.csv")
        path.write_bytes(gzip.compress(data, 1) if packed else data)
        command = self.estimate(path, *words)
        if make in (self._bad_cell, self._bad_header, self._too_large) and not words:
            command = self.random.choice([command, ["diagnose", str(path), "--effects", "slack"]])
        return BadInput(make.__name__, command)

    def _text(self, columns: dict[str, list[str]]) -> str:
        lines = [",".join(columns)]
        lines += [",".join(cells) for cells in zip(*columns.values(), strict=True)]
        return "\n".join(lines) + "\n"

    def _bad_cell(self, columns: dict[str, list[str]]) -> str:
        cells = columns[self.random.choice(COLUMNS)]
        bad = self.random.choice([*NO_NUMBERS, "x" * 3000, "9" * 400 + "z", "\x00", "\u0663a"])
        cells[self.random.randrange(len(cells))] = f'"{bad}"'
        return self._text(columns)

    def _bad_number(self, columns: dict[str, list[str]]) -> str:
        name = self.random.choice(COLUMNS[1:])
        cells = columns[name]
        bad = ["nan", "inf", "-inf", "1e309", "", "1e6", "-1e6", "NaN", "Infinity"]
        cells[self.random.randrange(len(cells))] = self.random.choice(bad)
        return self._text(columns)

    def _bad_header(self, columns: dict[str, list[str]]) -> str:
        names, body = ",".join(columns), self._text(columns).partition("\n")[2]
        head = self.random.choice(
            [
                "", " ", "1,2,3,4,5", names.replace(",", ";"), names.replace(",", "\t"),
                "# " + names, names.replace("time_s", "time"), names + ",time_s",
                names.replace("proximal_tension_N", "proximal_tension_N\x07"), '"' + names,
                names.replace("tension_N", "tension_mN"), names.replace("_m", "_mm"),
                names.replace("proximal_tension_N", "proximal_torque_Nm"), "\ufeff\ufeff" + names,
                names.replace("_", "\u00a0"), ",".join(f"c{k}" for k in range(1001)), "a" * 2**21,
            ]
        )  # fmt: skip
        return f"{head}\n{body}"

    def _bad_rows(self, columns: dict[str, list[str]]) -> str:
        lines = self._text(columns).splitlines()
        k = self.random.randrange(1, len(lines))
        lines[k] += self.random.choice([",", ",1", ",,,", '"', ',"', "\n,", "\n1"])
        cut = self.random.choice([None, None, None, 1])
        return "\n".join(lines[:cut]) + "\n"

    def _bad_time(self, columns: dict[str, list[str]]) -> str:
        time = columns["time_s"]
        k = self.random.randrange(1, len(time))
        kind = self.random.randrange(4)
        if kind == 0:
            time[k] = time[k - 1]
        elif kind == 1:
            time.reverse()
        elif kind == 2:
            time[k] = self.random.choice(["nan", "", "inf", "-1e300", "1e300"])
        else:
            step = self.random.choice([1, 0.5, 5, 1000, 1e9])
            columns["time_s"] = [repr(step * row) for row in range(len(time))]
        return self._text(columns)

    def _bad_unit(self, columns: dict[str, list[str]]) -> tuple[str, list[str]]:
        channel, name = self.random.choice(
            [
                ("time", "t_mm"), ("time", "t_kgf"), ("time", "t[fortnights]"), ("time", "t[]"),
                ("proximal_tension", "T_mm"), ("proximal_tension", "T_Nm"),
                ("proximal_tension", "T[bar]"), ("proximal_displacement", "q_deg"),
                ("proximal_displacement", "q_kgf"), ("distal_tension", "T_ms"),
                ("proximal_displacement", "q[N]"), ("distal_displacement", "q[[m]]"),
            ]
        )  # fmt: skip
        standard = {c.rpartition("_")[0]: c for c in COLUMNS}[channel]
        columns[name.partition("[")[0]] = columns[standard]
        return self._text(columns), ["--column", f"{channel}={name}"]

    def _too_large(self, columns: dict[str, list[str]]) -> str:
        text = self._text(columns)
        return self.random.choice(
            [
                lambda: text + "0" * (1 << 22),
                lambda: text + "\n" * 20_000,
                lambda: text + '"' + "x" * (1 << 22) + '",1,1,1,1\n',
                lambda: text + '"' + "x\n" * (1 << 18) + '",1,1,1,1\n',
                lambda: ",".join(f"c{k}" for k in range(100_000)) + "\n" + text,
                lambda: text.replace("\n", "," + "y" * 140_000 + "\n"),
            ]
        )()

    def _bad_encoding(self, columns: dict[str, list[str]]) -> bytes:
        text = self._text(columns)
        return self.random.choice(
            [
                text.encode("utf-16"), text.encode("utf-32"), text.encode("cp037"),
                text.replace("time_s", "zeit_\u00e4,time_s").encode("latin-1"),
                text.encode() + b"\xff\xfe,1,1,1,1\n", self.random.randbytes(5000),
                gzip.compress(text.encode()), b"\x00" * 10_000,
            ]
        )  # fmt: skip

    def mutated_table(self) -> BadInput:
        text = self._text(self.table()).encode()
        suffix = self.random.choice([".csv", ".csv.gz", ".parquet"])
        if suffix == ".csv.gz":
            text = gzip.compress(text)
        elif suffix == ".parquet":
            text = self._parquet(
                {name: pa.array(map(float, c)) for name, c in self.table().items()}
            )
        path = self.folder / f"data{suffix}"
        path.write_bytes(self.mutate(text))
        return BadInput("mutated" + suffix, self.estimate(path), refused=False)

    def mutate(self, data: bytes) -> bytes:
        """Return bytes in which some are changed, copied, cut out, or numbers made large."""
        out = bytearray(data)
        for _ in range(self.random.randint(1, 6)):
            at = self.random.randrange(len(out))
            kind = self.random.randrange(5)
            if kind == 0:
                out[at] ^= 1 << self.random.randrange(8)
            elif kind == 1:
                out[at : at + 4] = self.random.choice([b"\xff" * 4, bytes(4), b"\x7f\xff\xff\xff"])
            elif kind == 2:
                length = self.random.randint(1, 64)
                out[at:at] = out[at - length : at]
            elif kind == 3:
                del out[at : at + self.random.randint(1, 64)]
            else:
                out[at : at + 8] = (1 << self.random.choice([20, 31, 33, 62])).to_bytes(8, "little")
            if not out:
                return b"\x00"
        return bytes(out)

    # Parquet

    def parquet(self) -> BadInput:
        columns = {name: pa.array(map(float, cells)) for name, cells in self.table().items()}
        rows = len(columns["time_s"])
        name = self.random.choice(COLUMNS[:2])
        odd = {
            "bool": pa.array([True] * rows),
            "binary": pa.array([b"1.5"] * rows),
            "fixed binary": pa.array([b"12345678"] * rows, pa.binary(8)),
            "list": pa.array([[1.0]] * rows),
            "struct": pa.array([{"a": 1.0}] * rows),
            "map": pa.array([[("a", 1.0)]] * rows, pa.map_(pa.string(), pa.float64())),
            "date": pa.array([1] * rows, pa.date32()),
            "time": pa.array([1] * rows, pa.timestamp("ns")),
            "duration": pa.array([1] * rows, pa.duration("ns")),
            "text": pa.array(["x"] * rows),
            "categories": pa.array(["x"] * rows).dictionary_encode(),
            "null": pa.nulls(rows),
            "long text": pa.array(["y" * 200_000] * rows),
            "nan": pa.array([float("nan")] * rows),
        }
        kinds = [*odd, "wide", "many rows", "printable", "no rows", "footer", "cut", "empty name"]
        kind = self.random.choice(kinds)
        if kind in odd:
            columns[name] = odd[kind]
        elif kind == "wide":
            columns |= {f"c{k}": columns["time_s"] for k in range(1000)}
        elif kind == "many rows":
            constant = pa.chunked_array([pa.array(np.zeros(1 << 20))] * 60)
            columns = dict.fromkeys(COLUMNS[:2], constant)
        elif kind == "printable":
            columns["a\nb\x00"] = columns["time_s"]
        elif kind == "no rows":
            columns = {name: column[:0] for name, column in columns.items()}
        elif kind == "empty name":
            columns = {"" if name == c else c: column for c, column in columns.items()}
        data = self._parquet(columns)
        if kind == "footer":
            length = self.random.choice([0, 7, len(data), 1 << 30, (1 << 32) - 1])
            data = data[:-8] + struct.pack("<I", length) + b"PAR1"
        elif kind == "cut":
            data = data[: self.random.randrange(1, len(data))]
        path = self.folder / "data.parquet"
        path.write_bytes(data)
        return BadInput(f"parquet {kind}", self.estimate(path))

    @staticmethod
    def _parquet(columns: dict[str, pa.Array]) -> bytes:
        file = io.BytesIO()
        parquet.write_table(pa.table(columns), file)
        return file.getvalue()

    # recordings

    def recording(self) -> BadInput:
        kind = self.random.choice(list(CHUNKS))
        path = self.folder / "run.mcap"
        path.write_bytes(
            MCAP0_MAGIC + CHUNKS[kind](self.random) + self.random.choice([b"", b"\x0f"])
        )
        return BadInput(f"recording {kind}", self._on_recording(path))

    def _on_recording(self, path: Path) -> list[str]:
        return self.random.choice(
            [
                self.estimate(path),
                ["diagnose", str(path), "--effects", "slack"],
                ["recordings", "to-ros2", str(path), "--out", str(self.folder / "bag")],
                ["view", str(path), "--view", "none", "--duration", "0.1"],
                ["replay", str(path)],
            ]
        )

    def mutated_recording(self) -> BadInput:
        path = self.folder / "run.mcap"
        path.write_bytes(self.mutate(recording_bytes(self.folder, self.random)))
        words = self.random.choice(
            [
                self.estimate(path),
                ["recordings", "to-ros2", str(path), "--out", str(self.folder / "bag")],
            ]
        )
        return BadInput("mutated recording", words, refused=False)

    # bags

    def bag(self) -> BadInput:
        folder = self.folder / "bag"
        folder.mkdir()
        kind = self.random.choice(list(BAGS))
        messages = [joint_state(k, BAGS[kind]) for k in range(40)]
        name = JOINT_STATE if kind != "other type" else "std_msgs/msg/String"
        data = bag_bytes("/joint_states", name, messages)
        if kind == "bytes":
            data = bag_bytes("/joint_states", JOINT_STATE, [self.random.randbytes(60)] * 9)
        elif kind == "long sequence":
            head = encode(build_header(SECOND_NS)) + struct.pack("<I", 1 << 31)
            data = bag_bytes("/joint_states", JOINT_STATE, [head] * 9)
        elif kind == "wrench alone":
            wrench = build_message(WRENCH, force=build_message(VECTOR3, x=1.0))
            one = build_message(WRENCH_STAMPED, header=build_header(SECOND_NS), wrench=wrench)
            data = bag_bytes("/w", WRENCH_STAMPED, [encode(one)] * 9)
        (folder / "bag.mcap").write_bytes(data)
        about = {"rosbag2_bagfile_information": {"relative_file_paths": ["bag.mcap"]}}
        text = yaml.safe_dump(about)
        if kind == "metadata":
            text = self.random.choice(METADATA)
        (folder / "metadata.yaml").write_text(text)
        words = [] if kind in ("units", "metadata") else [f"--column={c}" for c in NAMED]
        return BadInput(f"bag {kind}", self.estimate(folder, *words))

    def mutated_bag(self) -> BadInput:
        messages = [joint_state(k, {}) for k in range(40)]
        path = self.folder / "bag.mcap"
        path.write_bytes(self.mutate(bag_bytes("/joint_states", JOINT_STATE, messages)))
        words = [f"--column={c}" for c in NAMED]
        return BadInput("mutated bag", self.estimate(path, *words), refused=False)

    # configs

    def config(self) -> BadInput:
        path = self.folder / "config.yaml"
        tree = yaml.safe_load(self.random.choice(CONFIGS).read_text())
        kind = self.random.choice(["key", "value", "value", "number", "text"])
        if kind == "text":
            path.write_bytes(self.random.choice(TEXTS))
            return BadInput("config text", ["load", str(path)])
        node, key = self.random.choice(leaves(tree))
        refused = True
        if kind == "key" and isinstance(node, dict):
            node["no_such_key"] = 1
            refused = "bus" not in str(key)
        elif kind == "number" and isinstance(node[key], float | int):
            node[key] = self.random.choice([float("nan"), "many", [1.0], -(10.0**300), "1 N"])
            refused = node[key] != -(10.0**300)
        else:
            node[key] = {"no_such_key": {"a": 1}}
        path.write_text(yaml.safe_dump(tree))
        return BadInput(f"config {kind}", ["load", str(path)], refused)

    # what is no file

    def no_file(self) -> BadInput:
        suffix = self.random.choice(["csv", "csv.gz", "parquet", "mcap", "rrd", "yaml"])
        path = self.folder / f"data.{suffix}"
        kind = self.random.choice(["pipe", "zero", "full", "folder", "loop", "gone", "noise", "0"])
        if kind == "pipe":
            os.mkfifo(path)
        elif kind in ("zero", "full"):
            path.symlink_to(f"/dev/{kind}")
        elif kind == "folder":
            path.mkdir()
        elif kind == "loop":
            path.symlink_to(path)
        elif kind == "noise":
            path.write_bytes(b"RRF2" * (suffix == "rrd") + self.random.randbytes(3000))
        elif kind == "0":
            path.write_bytes(b"")
        words = {"yaml": ["load", str(path)], "rrd": ["view", str(path), "--view", "web"]}
        refused = (suffix, kind) != ("yaml", "0")  # an empty config has defaults
        command = words.get(suffix, self.estimate(path))
        return BadInput(f"no file: {kind}.{suffix}", command, refused)


def chunk(content: bytes, claimed: int | None = None, compression: str = "zstd") -> bytes:
    """Return the record of a chunk that claims a size."""
    pack = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}.get(compression, bytes)
    builder = RecordBuilder()
    size = len(content) if claimed is None else claimed
    records.Chunk(compression, pack(content), 0, 0, 0, size).write(builder)
    return builder.end()


def topic(schema: bytes, messages: list[bytes], name: str = "/tendons") -> bytes:
    """Return the records of a topic: schema, channel and messages."""
    builder = RecordBuilder()
    kind = "tendon_teleop/msg/TendonState"
    records.Schema(data=schema, encoding="ros2msg", id=1, name=kind).write(builder)
    _channel(name).write(builder)
    for k, data in enumerate(messages):
        _message(data, k).write(builder)
    return builder.end()


def _channel(name: str) -> records.Channel:
    return records.Channel(id=1, topic=name, message_encoding="cdr", metadata={}, schema_id=1)


def _message(data: bytes, k: int) -> records.Message:
    stamp = 10**18 + k
    return records.Message(channel_id=1, data=data, log_time=stamp, publish_time=stamp, sequence=k)


def frame(opcode: Opcode, length: int, body: bytes = b"") -> bytes:
    return struct.pack("<BQ", opcode, length) + body


CHUNKS: dict[str, Callable[[random.Random], bytes]] = {
    "bomb": lambda r: chunk(bytes(1 << r.choice([20, 25, 27])), 100, r.choice(["zstd", "lz4"])),
    "claims": lambda r: chunk(b"x" * 50, 1 << r.choice([10, 27, 40, 63]), r.choice(["zstd", "lz4", ""])),
    "compression": lambda r: chunk(b"x" * 50, compression=r.choice(["gzip", "ZSTD", "\x00"])),
    "noise": lambda r: chunk(r.randbytes(500)),
    "record beyond": lambda r: chunk(frame(Opcode.MESSAGE, 1 << r.choice([8, 31, 63]), b"x" * 40)),
    "no channel": lambda r: chunk(frame(Opcode.MESSAGE, 30, struct.pack("<HIQQ", 7, 1, 1, 1) + b"12345678")),
    "short message": lambda r: chunk(topic(b"float64 time_s", [b""] * 3)),
    "other fields": lambda r: chunk(topic(b"float64 x", [bytes(12)] * 3)),
    "huge array": lambda r: chunk(topic(b"float64[%d] x" % r.choice([10**7, 2**31, 10**19]), [bytes(12)])),
    "bad schema": lambda r: chunk(topic(r.choice([b"\xff\xfe", b"float64", b"x" * 9999, b"float64[] x"]), [bytes(12)])),
    "no messages": lambda r: chunk(topic(b"float64 time_s", [])),
    "large record": lambda r: frame(r.choice([Opcode.CHUNK, Opcode.METADATA]), 1 << r.choice([29, 40, 63])),
    "cut chunk": lambda r: chunk(b"x" * 500)[: r.randrange(5, 60)],
    "empty chunks": lambda r: chunk(b"") * 50,
}  # fmt: skip

BAGS: dict[str, dict[str, tuple[float, ...]]] = {
    "units": {}, "metadata": {}, "bytes": {}, "long sequence": {}, "wrench alone": {},
    "other type": {}, "no effort": {"effort": ()}, "not finite": {"effort": (float("nan"),)},
    "infinite": {"effort": (float("inf"),)}, "large": {"effort": (1e9,)}, "pushing": {"effort": (-9.0,)},
}  # fmt: skip
NAMED = (
    "proximal_tension=/joint_states/a/effort",
    "proximal_displacement=/joint_states/a/position",
)
METADATA = (
    "", "a: 1", "[]", "rosbag2_bagfile_information: 3", "a: [", "\x00", "!!python/object:os.system x",
    "rosbag2_bagfile_information: {relative_file_paths: 3}",
    "rosbag2_bagfile_information: {relative_file_paths: [../../etc/passwd]}",
    "rosbag2_bagfile_information: {relative_file_paths: [gone.mcap]}",
    "rosbag2_bagfile_information: {relative_file_paths: [bag.db3]}",
    "rosbag2_bagfile_information: {relative_file_paths: []}",
    "rosbag2_bagfile_information: {relative_file_paths: [bag.mcap, bag.mcap]}",
    "a: &a [1,1,1,1,1,1,1,1,1]\nb: &b [*a,*a,*a,*a,*a,*a,*a,*a,*a]\nc: [*b,*b,*b,*b,*b,*b]",
    "{a: " * 2000,
)  # fmt: skip
TEXTS = (
    b"\x00", b"\xff\xfe", b"[]", b"3", b"a: [", b"master: 3", b"no_such_section: {}", b"- x", b"\t: a",
    b"session: a\nsession: b", b"? [a]: b", b"{a: " * 3000, b"x" * 200_000, b"session: !!python/name:os",
    b"a: &a [*a]", b"&a a: *a", b"session: " + b"9" * 9000, b"rate_hz: 1e999", b"session: 'a", b"%",
)  # fmt: skip


def joint_state(k: int, changes: dict[str, tuple[float, ...]]) -> bytes:
    fields = {"position": (0.001 * k,), "effort": (1.0 + 0.1 * k,)} | changes
    header = build_header(1000 * SECOND_NS + k * 10_000_000)
    return encode(build_joint_state(header, ("a",), **fields))


def bag_bytes(name: str, kind: str, messages: list[bytes]) -> bytes:
    """Return an MCAP file of one topic, in one chunk."""
    builder = RecordBuilder()
    records.Schema(data=b"", encoding="ros2msg", id=1, name=kind).write(builder)
    _channel(name).write(builder)
    for k, data in enumerate(messages):
        _message(data, k).write(builder)
    content = builder.end()
    records.Header(profile="ros2", library="x").write(builder)
    header = builder.end()
    return MCAP0_MAGIC + header + chunk(content)


def leaves(tree: object) -> list[tuple[dict | list, object]]:
    """Return (container, key) of all values in a tree that are no containers."""
    found = []
    stack = [tree]
    while stack:
        node = stack.pop()
        for key, value in node.items() if isinstance(node, dict) else enumerate(node):
            if isinstance(value, dict | list):
                stack.append(value)
            else:
                found.append((node, key))
    return found


def run(case: BadInput) -> tuple[object, str]:
    """Run a case in this process; return the exit code and what it said."""
    if case.words[0] == "load":
        with contextlib.redirect_stderr(io.StringIO()) as said:
            return load_all(Path(case.words[1])), said.getvalue()
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        try:
            code = commands.main(case.words)
        except SystemExit as end:
            code = end.code
    return code, said.getvalue()


def judge(number: int, seed: int, folder: Path) -> dict[str, object] | None:
    """Run one case; return what is wrong with its answer."""
    case = BadInputs(seed * 1_000_000 + number, folder).draw()
    before = contents(folder)
    signal.alarm(HANG_S)
    signal.setitimer(signal.ITIMER_PROF, HANG_CPU_S)
    try:
        code, said = run(case)
        check(case.words, (folder / "bag",), code, said, before, contents(folder))
        assert code == 2 or not case.refused, f"exit code {code}: {said}"
    except BaseException as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        return {
            "number": number, "kind": case.kind, "words": case.words, "error": repr(error)[:500],
            "place": f"{place.filename}:{place.lineno}",
        }  # fmt: skip
    finally:
        signal.alarm(0)
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    return None


def main(seed: int, first: int, end: int, folder: Path) -> None:
    """Run cases in bounded memory."""
    signal.signal(signal.SIGALRM, hang)
    signal.signal(signal.SIGPROF, hang)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY_MAX
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    for number in range(first, end):
        place = folder / str(number)
        place.mkdir()
        os.chdir(place)
        if wrong := judge(number, seed, place):
            print(json.dumps(wrong), flush=True)
    print(json.dumps({"ran": end - first}), flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:4]), Path(sys.argv[4]))
