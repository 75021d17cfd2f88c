# ruff: noqa: E501, ARG005 - tables of bad bytes, and of functions of one signature

"""Inputs that must be refused, drawn by seed: Parquet, recordings, bags, and what is no file.

Tables and configs: tests/teleop/data, tests/teleop/test_config.py, and `Fuzz`, which damages them.

`python -m tests.fuzz.bad_inputs SEED FIRST END FOLDER` runs some of them in bounded memory, and
prints what was wrong, one line of JSON each.
"""

import io
import json
import os
import random
import resource
import struct
import sys
from collections.abc import Callable
from pathlib import Path

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
from tests.fuzz.cases import COLUMNS, Case, Fuzz
from tests.fuzz.running import judge

MEMORY_MAX = 4_000_000_000  # [bytes] of address space, beyond what Python and its packages take; compiling takes 1
SECOND_NS = 1_000_000_000
MODEL = ("--set", "slave.tendons=[{effective_friction: 0.5}]")


class BadInputs(Fuzz):
    """Draws bad inputs into a folder; the same seed draws the same."""

    def draw(self):
        """Return a bad input; its files are in the folder."""
        kinds = [
            self.parquet, self.parquet, self.mutated_parquet, self.chunk, self.chunk,
            self.recording, self.bag, self.bag, self.mutated_bag, self.no_file,
        ]  # fmt: skip
        return self.random.choice(kinds)()

    def estimate(self, path, *words):
        return ["estimate", str(path), *MODEL, *words]

    # Parquet

    def signals(self):
        time = 0.01 * np.arange(self.random.randint(20, 90))
        tension = 6.0 - 5.0 * np.cos(8.0 * time)
        values = [time, tension, 1e-4 * tension, 0.4 * tension, 1e-5 * tension]
        return dict(zip(COLUMNS, map(pa.array, values), strict=True))

    def mutated_parquet(self):
        path = self.folder / "data.parquet"
        path.write_bytes(self.damage(self._to_parquet(self.signals())))
        return Case(self.estimate(path))

    def parquet(self):
        columns = self.signals()
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
        data = self._to_parquet(columns)
        if kind == "footer":
            length = self.random.choice([0, 7, len(data), 1 << 30, (1 << 32) - 1])
            data = data[:-8] + struct.pack("<I", length) + b"PAR1"
        elif kind == "cut":
            data = data[: self.random.randrange(1, len(data))]
        path = self.folder / "data.parquet"
        path.write_bytes(data)
        return Case(self.estimate(path), refused=True)

    @staticmethod
    def _to_parquet(columns):
        file = io.BytesIO()
        parquet.write_table(pa.table(columns), file)
        return file.getvalue()

    # recordings

    def chunk(self):
        kind = self.random.choice(list(CHUNKS))
        path = self.folder / "run.mcap"
        path.write_bytes(
            MCAP0_MAGIC + CHUNKS[kind](self.random) + self.random.choice([b"", b"\x0f"])
        )
        return Case(self._on_recording(path), refused=True)

    def _on_recording(self, path):
        return self.random.choice(
            [
                self.estimate(path),
                ["diagnose", str(path), "--effects", "slack"],
                *self._conversions(path),
                ["view", str(path), "--view", "none", "--duration", "0.1"],
                ["replay", str(path)],
            ]
        )

    def _conversions(self, path):
        out = self.folder / "out"
        return [
            ["recordings", "to-ros2", str(path), "--out", str(out)],
            ["recordings", "to-table", str(path), "--out", f"{out}.csv", "--to", "1"],
            ["recordings", "to-lerobot", str(path), "--out", str(out), "--task", "x"],
        ]

    # bags

    def bag(self):
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
        return Case(self.estimate(folder, *words), refused=True)

    def mutated_bag(self):
        messages = [joint_state(k, {}) for k in range(40)]
        path = self.folder / "bag.mcap"
        path.write_bytes(self.damage(bag_bytes("/joint_states", JOINT_STATE, messages)))
        words = [f"--column={c}" for c in NAMED]
        return Case(self.estimate(path, *words))

    # what is no file

    def no_file(self):
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
        return Case(words.get(suffix, self.estimate(path)), refused=refused)


def chunk(content, claimed=None, compression="zstd"):
    """Return the record of a chunk that claims a size."""
    pack = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}.get(compression, bytes)
    builder = RecordBuilder()
    size = len(content) if claimed is None else claimed
    records.Chunk(compression, pack(content), 0, 0, 0, size).write(builder)
    return builder.end()


def topic(schema, messages, name="/tendons"):
    """Return the records of a topic: schema, channel and messages."""
    builder = RecordBuilder()
    kind = "tendon_teleop/msg/TendonState"
    records.Schema(data=schema, encoding="ros2msg", id=1, name=kind).write(builder)
    _channel(name).write(builder)
    for k, data in enumerate(messages):
        _message(data, k).write(builder)
    return builder.end()


def _channel(name):
    return records.Channel(id=1, topic=name, message_encoding="cdr", metadata={}, schema_id=1)


def _message(data, k):
    stamp = 10**18 + k
    return records.Message(channel_id=1, data=data, log_time=stamp, publish_time=stamp, sequence=k)


def frame(opcode, length, body=b""):
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


def joint_state(k, changes):
    fields = {"position": (0.001 * k,), "effort": (1.0 + 0.1 * k,)} | changes
    header = build_header(1000 * SECOND_NS + k * 10_000_000)
    return encode(build_joint_state(header, ("a",), **fields))


def bag_bytes(name, kind, messages):
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


def main(seed, first, end, folder):
    """Run cases in bounded memory."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MEMORY_MAX
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    for number in range(first, end):
        place = folder / str(number)
        place.mkdir()
        os.chdir(place)
        if wrong := judge(BadInputs(seed * 1_000_000 + number, place).draw(), place):
            print(json.dumps(wrong), flush=True)
    print(json.dumps({"ran": end - first}), flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:4]), Path(sys.argv[4]))
