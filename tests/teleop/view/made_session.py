"""A session's messages, made up, and what the view made of them, read back with Rerun's reader."""

import math
import warnings

import numpy as np
import rerun as rr
from rerun.chunk import RrdReader

from teleop.messages.messages import (
    MAX_JOINTS,
    MAX_MESSAGE_SECTIONS,
    MAX_TENDONS,
    PROFILE_POINTS,
    Command,
    Event,
    Hand,
    Ledger,
    LoopReport,
    Sheath,
    SlaveState,
    TendonState,
    TensionProfile,
    encode_text,
    pad_values,
)
from teleop.messages.topics import (
    COMMAND,
    EVENT,
    HAND,
    LEDGER,
    PROFILE,
    REPORT,
    SHEATH,
    STATE,
    TENDONS,
    Role,
)
from teleop.session.state_machine import State
from teleop.view.columns import decode
from teleop.view.config import ViewConfig
from teleop.view.scene import Scene
from teleop.view.sinks import Sink

T0 = 1_790_000_000_000_000_000
SENDER = 77
CONFIG = ViewConfig(tension_scale_N=10.0)
FORCE_MAX_N = 20.0  # twice what is reached, so that the force is far from its limit


def tendon_state(k, bench=True):
    value = 5 + 4 * math.sin(k / 50)
    return TendonState(
        tendons=2,
        proximal_tension=pad_values((value, value + 1), MAX_TENDONS),
        phase=(2 + k // 250, 4, *(0,) * (MAX_TENDONS - 2)),
        elongation=pad_values((value * 1e-4, 0.0), MAX_TENDONS),
        front=pad_values((0.2, 0.1), MAX_TENDONS),
        proximal_displacement=pad_values((k * 1e-6, math.nan), MAX_TENDONS),
        distal_tension=pad_values((value / 2, value / 3), MAX_TENDONS),
        distal_tension_low=pad_values((value / 3, value / 4), MAX_TENDONS),
        distal_tension_high=pad_values((value, value / 2), MAX_TENDONS),
        bench_distal_tension=pad_values(
            (value / 2 + 1.0 if bench else math.nan, math.nan), MAX_TENDONS
        ),
        bench_distal_displacement=(math.nan,) * MAX_TENDONS,
    )


def front_of(k, tendon=0):
    """X' [m] runs along the sheath, and begins anew."""
    return (0.1 + 0.3 * tendon + k * 0.8 / 1000) % 0.8


def tension_profile(k, tendon=0):
    x = np.linspace(0, 1, PROFILE_POINTS)
    tension = (6 + tendon + math.sin(k)) * np.exp(-x / 3)
    return TensionProfile(
        tendon=tendon, length=0.8, front=front_of(k, tendon), tension=tuple(tension.tolist())
    )


def sheath(tendon=0):
    return Sheath(
        tendon=tendon,
        sections=2,
        effective_friction=0.4,
        section_length=pad_values((0.3, 0.5), MAX_MESSAGE_SECTIONS),
        section_radius=pad_values((math.inf, 0.2), MAX_MESSAGE_SECTIONS),
    )


class Session:
    """A session's messages, packed in order of time."""

    def __init__(self, seconds=1.0):
        self.messages = []
        self.sequences = {}
        for k in range(round(seconds * 1000)):
            stamp = T0 + k * 1_000_000
            self.add(TENDONS, tendon_state(k), stamp)
            force = pad_values((k * 0.01,), MAX_JOINTS)
            ends = {"force_low": pad_values((k * 0.01 - 0.3,), MAX_JOINTS)}
            ends["force_high"] = pad_values((k * 0.01 + 0.5,), MAX_JOINTS)
            travel = pad_values((k * 1e-5,), MAX_JOINTS)
            mode = State.READY if k < 400 else State.ENGAGED
            told = SlaveState(state=mode, joints=1, position=travel, force=force, **ends)
            self.add(STATE, told, stamp)
            hand = pad_values((-k * 0.003,), MAX_JOINTS)
            self.add(HAND, Hand(state=mode, joints=1, force=hand), stamp)
            travel = pad_values((k * 1e-5,), MAX_JOINTS)
            self.add(COMMAND, Command(position=travel, force_max=FORCE_MAX_N), stamp)
            if k % 20 == 0:
                for tendon in (0, 1):
                    self.add(PROFILE, tension_profile(k, tendon), stamp)
            if k % 10 == 0:
                for role in (Role.MASTER, Role.SLAVE):
                    spent = pad_values((k * 1e-6,), MAX_JOINTS)
                    self.add(LEDGER, Ledger(role=role, joints=1, dissipated=spent), stamp)
            if k % 1000 == 0:
                for tendon in (0, 1):
                    self.add(SHEATH, sheath(tendon), stamp)
            if k % 500 == 0:
                report = LoopReport(role=Role.SLAVE, rate_hz=999.5, lateness_max_ns=250_000, lost=k)
                self.add(REPORT, report, stamp)
        fault = Event(role=Role.SLAVE, state=State.FAULT, text=encode_text("load cell silent"))
        self.add(EVENT, fault, T0 + 300_000_000)

    def add(self, topic, message, stamp):
        sequence = self.sequences[topic] = self.sequences.get(topic, -1) + 1
        self.messages.append((topic, message.pack(SENDER, sequence, stamp)))

    def unpack(self):
        """Yield topic, message and stamp of each."""
        for topic, data in self.messages:
            message = topic.message.unpack(data)
            yield topic, message, message.stamp_ns

    def of(self, topic):
        return [topic.message.unpack(data) for t, data in self.messages if t is topic]


def reader(path):
    """Return Rerun's own reader of a file; ours have no footer, of which it warns."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rr.error_utils.RerunWarning)
        return RrdReader(path)


def read(path):
    """Return {entity: {component: {stamp: [values]}}}; static ones under the stamp None."""
    entities = {}
    for chunk in reader(path).stream():
        table = chunk.to_record_batch().to_pydict()
        stamps = table.get("time") or [None] * chunk.num_rows
        for name, column in table.items():
            if name in ("time", "rerun.controls.RowId"):
                continue
            rows = entities.setdefault(chunk.entity_path, {}).setdefault(name, {})
            for stamp, value in zip(stamps, column, strict=True):
                rows[stamp if stamp is None else np.datetime64(stamp, "ns").astype(int)] = value
    return entities


def save(messages, path, block=163, config=CONFIG, stretch=1.0):
    """Feed packed messages through the pipeline to a file, `block` of them at a time."""
    with Sink("rrd", config, "test", path, live=False) as sink:
        scene = Scene(config, sink.stream, sink.lay_out)
        scene.stretch(stretch)
        for start in range(0, len(messages), block):
            scene.send(decode(messages[start : start + block]))
    return read(path)
