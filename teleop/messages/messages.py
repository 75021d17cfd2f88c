"""Messages with a fixed layout, declared once.

A message is a frozen dataclass whose fields are annotated with a wire type (`F64`, `U32`, ...) or a
fixed array of one (`Joints`, `Tendons`, ...). From that one declaration come the packed bytes, the
numpy dtype, the ROS 2 message definition and the table in the docs. The bytes are CDR,
little-endian, as ROS 2 writes them: a four-byte encapsulation header, then each field at its
natural alignment. So the bytes on the network go into a recording unchanged.

Every message begins with the same five fields, which the link fills in and checks:

========== ==== ==========================================================================
checksum   u32  CRC-32 of the message's name and of everything after it: damaged messages and
                those of another kind are dropped and counted
layout     u32  CRC-32 of the declarations: a peer with another layout is refused
sender     u64  a nonce drawn when the process started: a restarted peer is a new sender
sequence   u64  incremented with each message of a topic: shows loss and reordering
stamp_ns   i64  when it was sent, on the sender's clock (`teleop.runtime.clock`)
========== ==== ==========================================================================
"""

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any, ClassVar, NamedTuple, Self, get_args, get_type_hints

import numpy as np

from teleop.errors import TeleopError

MAX_JOINTS = 8
MAX_TENDONS = 2 * MAX_JOINTS
MAX_MESSAGE_SECTIONS = 16  # of a sheath; the estimator itself takes `tables.MAX_SECTIONS`
PROFILE_POINTS = 65
TEXT_BYTES = 256
TOPIC_SLOTS = 16  # room for the topics of `teleop.messages.topics.TOPICS`

# Names of TendonState.phase, as in the paper
PHASE_NAMES = ("slack", "virgin", "pull", "pull to release", "release", "release to pull")
# The bits of SlaveState.status and TendonState.status, lowest first: estimator.online.online.Status
STATUS_NAMES = ("tension only", "uninitialised", "tip moved", "slack", "invalid input")

# Names of the stages in Latency's arrays
STAGE_NAMES = ("read to sent", "link both ways", "answered", "received to written", "all")

# Values of EmergencyStop.action
STOP_ACTIONS = ("stop", "reset", "watch", "leave")

SCHEMA_PACKAGE = "tendon_teleop"  # of the messages, where ROS 2 and recordings name them
ENCAPSULATION = b"\x00\x01\x00\x00"  # CDR, little-endian
CHECKSUM_START = len(ENCAPSULATION) + 4  # the checksum covers everything after it
HEAD, CHECKSUM = struct.Struct("<IIQQq"), struct.Struct("<I")


class MessageError(TeleopError):
    """Invalid message bytes; `kind` says in what way."""

    def __init__(self, kind: str, detail: str) -> None:
        super().__init__(f"{kind}: {detail}")
        self.kind = kind


class Head(NamedTuple):
    """Head of a message: sender, sequence number, stamp on the sender's clock."""

    sender: int  # nonce drawn when the sending process started
    sequence: int  # number of this message among those of its topic and sender, from 1
    stamp_ns: int  # when it was sent [ns since the Unix epoch, on the sender's clock]


@dataclass(frozen=True, slots=True)
class WireType:
    """Wire type of a field: `struct` code, ROS 2 and numpy names, fixed count."""

    code: str
    ros: str
    numpy: str
    count: int = 1

    @property
    def size(self) -> int:
        """Bytes of one element, which in CDR is its alignment too."""
        return struct.calcsize(self.code)


U32 = Annotated[int, WireType("I", "uint32", "<u4")]
U64 = Annotated[int, WireType("Q", "uint64", "<u8")]
I64 = Annotated[int, WireType("q", "int64", "<i8")]
F64 = Annotated[float, WireType("d", "float64", "<f8")]
JointFlags = Annotated[tuple[int, ...], WireType("I", "uint32", "<u4", MAX_JOINTS)]
Joints = Annotated[tuple[float, ...], WireType("d", "float64", "<f8", MAX_JOINTS)]
TendonFlags = Annotated[tuple[int, ...], WireType("I", "uint32", "<u4", MAX_TENDONS)]
Tendons = Annotated[tuple[float, ...], WireType("d", "float64", "<f8", MAX_TENDONS)]
Sections = Annotated[tuple[float, ...], WireType("d", "float64", "<f8", MAX_MESSAGE_SECTIONS)]
ProfilePoints = Annotated[tuple[float, ...], WireType("d", "float64", "<f8", PROFILE_POINTS)]

Stages = Annotated[tuple[int, ...], WireType("q", "int64", "<i8", len(STAGE_NAMES))]

TopicCounts = Annotated[tuple[int, ...], WireType("Q", "uint64", "<u8", TOPIC_SLOTS)]

TextBytes = Annotated[tuple[int, ...], WireType("B", "uint8", "u1", TEXT_BYTES)]

# Field defaults, one per array type
NO_JOINTS = (0.0,) * MAX_JOINTS
NO_JOINT_FLAGS = (0,) * MAX_JOINTS
NO_TENDONS = (0.0,) * MAX_TENDONS
NO_TENDON_FLAGS = (0,) * MAX_TENDONS
NO_SECTIONS = (0.0,) * MAX_MESSAGE_SECTIONS
NO_PROFILE = (0.0,) * PROFILE_POINTS
NO_STAGES = (0,) * len(STAGE_NAMES)
NO_TOPICS = (0,) * TOPIC_SLOTS
NO_TEXT = (0,) * TEXT_BYTES


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """The head of all messages; see the module's table."""

    checksum: U32 = 0
    layout: U32 = 0
    sender: U64 = 0
    sequence: U64 = 0
    stamp_ns: I64 = 0

    schema: ClassVar["Schema"]

    def pack(self, sender: int, sequence: int, stamp_ns: int) -> bytes:
        """Return the bytes to send, with the head filled in."""
        return self.schema.pack(self, sender, sequence, stamp_ns)

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Return the message in `data`; `MessageError` if it is damaged or of another layout."""
        message: Self = cls.schema.unpack(data)
        return message


class Schema:
    """The wire format of a message class, derived from its annotations."""

    def __init__(self, cls: type[Message]) -> None:
        hints = get_type_hints(cls, include_extras=True)
        self.cls = cls
        self.name = cls.__name__
        self.seed = zlib.crc32(self.name.encode())
        self.wires: dict[str, WireType] = {}
        for item in fields(cls):
            self.wires[item.name] = next(
                a for a in get_args(hints[item.name]) if isinstance(a, WireType)
            )
        code, offset, offsets = "<", 0, []
        for wire in self.wires.values():
            padding = -offset % wire.size
            code += f"{padding}x" * (padding > 0) + (f"{wire.count}" * (wire.count > 1)) + wire.code
            offsets.append(offset + padding)
            offset += padding + wire.size * wire.count
        self.size = offset + len(ENCAPSULATION)
        self._struct = struct.Struct(code)
        names = list(self.wires)
        formats = [(w.numpy, (w.count,)) if w.count > 1 else w.numpy for w in self.wires.values()]
        # of the bytes on the wire; and without encapsulation, in aligned memory
        self.dtype = _build_dtype(
            names, formats, [len(ENCAPSULATION) + o for o in offsets], self.size
        )
        self.record_dtype = _build_dtype(names, formats, offsets, -(-offset // 8) * 8, aligned=True)
        self.ros_definition = "".join(
            f"{w.ros}{f'[{w.count}]' if w.count > 1 else ''} {name}\n"
            for name, w in self.wires.items()
        )
        # (name, first slot, last slot or None for a scalar) in the flat tuple `struct` returns
        self._slots: list[tuple[str, int, int | None]] = []
        slot = 0
        for name, wire in self.wires.items():
            self._slots.append((name, slot, slot + wire.count if wire.count > 1 else None))
            slot += wire.count

    def pack(self, message: Message, sender: int, sequence: int, stamp_ns: int) -> bytes:
        """Pack `message` under the given head."""
        flat: list[Any] = [0, LAYOUT, sender, sequence, stamp_ns]
        for name, _, end in self._slots[5:]:
            value = getattr(message, name)
            if end is None:
                flat.append(value)
            else:
                flat.extend(value)
        body = self._struct.pack(*flat)[4:]
        return ENCAPSULATION + CHECKSUM.pack(self.compute_checksum(body)) + body

    def compute_checksum(self, body: bytes | memoryview) -> int:
        """Return the checksum of a message of this class from what follows the checksum in it."""
        return zlib.crc32(body, self.seed)

    def read_sender(self, data: bytes) -> int:
        """Return the sender in `data`, unchecked; 0 if it is too short."""
        short = len(data) < len(ENCAPSULATION) + HEAD.size
        return 0 if short else int(HEAD.unpack_from(data, len(ENCAPSULATION))[2])

    def check(self, data: bytes) -> Head:
        """Return the head of `data`; `MessageError` if it is damaged or of another layout."""
        if len(data) != self.size:
            raise MessageError("layout", f"{self.name} has {self.size} bytes, got {len(data)}")
        checksum, layout, sender, sequence, stamp_ns = HEAD.unpack_from(data, len(ENCAPSULATION))
        body = memoryview(data)[CHECKSUM_START:]
        if checksum != zlib.crc32(body, self.seed) or data[:4] != ENCAPSULATION:
            raise MessageError("corruption", f"{self.name} fails its checksum")
        if layout != LAYOUT:
            theirs, ours = f"{layout:08x}", f"{LAYOUT:08x}"
            raise MessageError("layout", f"{self.name} is of layout {theirs}, ours is {ours}")
        return Head(sender, sequence, stamp_ns)

    def unpack(self, data: bytes) -> Any:
        """Check and unpack `data`."""
        self.check(data)
        flat = self._struct.unpack_from(data, len(ENCAPSULATION))
        values: dict[str, Any] = {
            name: flat[slot] if end is None else flat[slot:end] for name, slot, end in self._slots
        }
        return self.cls(**values)


def _build_dtype(
    names: list[str], formats: list[Any], offsets: list[int], size: int, aligned: bool = False
) -> np.dtype[Any]:
    layout: Any = {"names": names, "formats": formats, "offsets": offsets, "itemsize": size}
    structure: np.dtype[Any] = np.dtype(layout, align=aligned)
    return structure


def pad_values(values: Sequence[float], size: int) -> tuple[float, ...]:
    """Return `values` filled up with zeros to the `size` of an array field."""
    if len(values) > size:
        raise ValueError(f"{len(values)} values do not fit into a field of {size}")
    return (*values, *(0.0,) * (size - len(values)))


def encode_text(text: str) -> tuple[int, ...]:
    """Return `text` as UTF-8, cut and zero-padded to `TEXT_BYTES`; what is no text becomes `?`."""
    raw = text.encode(errors="replace")[:TEXT_BYTES].decode(errors="ignore").encode()
    return tuple(raw.ljust(TEXT_BYTES, b"\0"))


def decode_text(raw: tuple[int, ...]) -> str:
    """Return the text in a `TextBytes` field, on one line.

    Control characters and changes of writing direction become spaces.
    """
    text = bytes(raw).rstrip(b"\0").decode(errors="replace")
    return "".join(letter if letter.isprintable() else " " for letter in text)


@dataclass(frozen=True, slots=True, kw_only=True)
class Command(Message):
    """Master to slave, at `rate_hz`: the setpoints of the tips."""

    state: U32 = 0  # teleop.session.state_machine.State of the master
    reason: U32 = 0  # teleop.session.state_machine.Reason behind it
    echo_stamp_ns: I64 = 0  # stamp_ns of the newest SlaveState received, 0 = none
    position: Joints = NO_JOINTS  # [m] commanded tip travel, positive = pulled in
    velocity: Joints = NO_JOINTS  # [m/s]
    stops: U32 = 0  # emergency stops at this side so far; a reset gives this number
    coupling: U32 = 0  # teleop.coupling.Bilateral.signature; 0 = unknown
    force_max: F64 = 0.0  # [N] at the tip; largest rendered force
    energy: Joints = NO_JOINTS  # [J] passed on to the slave since the sender started
    wave: Joints = NO_JOINTS  # [sqrt(J s)] integral of the waves sent to it


@dataclass(frozen=True, slots=True, kw_only=True)
class SlaveState(Message):
    """Slave to master, every slave tick: the force at the tips, with its certified interval."""

    state: U32 = 0  # teleop.session.state_machine.State of the slave
    reason: U32 = 0  # teleop.session.state_machine.Reason behind it
    joints: U32 = 0  # how many entries of the arrays are in use
    echo_stamp_ns: I64 = 0  # stamp_ns of the Command this state answers, 0 = none
    position: Joints = NO_JOINTS  # [m] estimated tip travel
    force: Joints = NO_JOINTS  # [N] estimated distal force, positive = against pulling
    force_low: Joints = NO_JOINTS  # [N] the certified interval's ends
    force_high: Joints = NO_JOINTS  # [N]
    force_margin: Joints = NO_JOINTS  # [N] by which its size may be less as an adapted K may differ
    status: JointFlags = NO_JOINT_FLAGS  # bits named by STATUS_NAMES, all tendons of the joint
    sample_age_ns: I64 = 0  # since the newest usable sample; 0 while there is none
    stops: U32 = 0  # as in Command
    coupling: U32 = 0  # as in Command
    energy: Joints = NO_JOINTS  # [J] passed on to the master since the sender started
    wave: Joints = NO_JOINTS  # [sqrt(J s)] integral of the waves sent to it
    answer_ns: I64 = 0  # from the Command's receipt to this state's sending; 0 = no new one
    force_reduction: F64 = 0.0  # part of the forces that neither side renders: degraded mode
    probing: U32 = 0  # number of the tendon whose friction is being probed, from 1; 0 = none


@dataclass(frozen=True, slots=True, kw_only=True)
class TendonState(Message):
    """Slave to listeners, every rig sample: all tendons in detail, bench sensors too."""

    tendons: U32 = 0  # how many entries of the arrays are in use
    time_s: F64 = 0.0  # rig time of the sample; one message per sample
    proximal_tension: Tendons = NO_TENDONS  # [N] measured at the housing
    proximal_displacement: Tendons = NO_TENDONS  # [m] NaN without an encoder
    # [m] output of the gate; NaN before the first engagement
    commanded_displacement: Tendons = NO_TENDONS
    distal_tension: Tendons = NO_TENDONS  # [N] estimated
    distal_tension_low: Tendons = NO_TENDONS  # [N]
    distal_tension_high: Tendons = NO_TENDONS  # [N]
    elongation: Tendons = NO_TENDONS  # [m] estimated
    front: Tendons = NO_TENDONS  # [m] X', front of the newest reversal
    phase: TendonFlags = NO_TENDON_FLAGS  # index into PHASE_NAMES
    status: TendonFlags = NO_TENDON_FLAGS  # estimator.online.online.Status flags
    bench_distal_tension: Tendons = NO_TENDONS  # [N] NaN without a bench sensor
    bench_distal_displacement: Tendons = NO_TENDONS  # [m] NaN without a bench sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Hand(Message):
    """Master to listeners, every master tick: the hand and the rendered force."""

    state: U32 = 0  # teleop.session.state_machine.State of the sender
    reason: U32 = 0  # teleop.session.state_machine.Reason behind it
    joints: U32 = 0  # how many entries of the arrays are in use
    round_trip_ns: I64 = 0  # from a command sent to its force written; 0 = no new answer
    state_age_ns: I64 = 0  # age of the newest SlaveState; -1 = none yet
    position: Joints = NO_JOINTS  # [m] of the device
    velocity: Joints = NO_JOINTS  # [m/s]
    force: Joints = NO_JOINTS  # [N] written to the device, positive = along +position


@dataclass(frozen=True, slots=True, kw_only=True)
class TensionProfile(Message):
    """Slave to listeners, at view rate: T(x) along one tendon at `length * k / (points - 1)`."""

    tendon: U32 = 0  # which one, from 0
    length: F64 = 0.0  # [m]
    front: F64 = 0.0  # [m] X'
    tension: ProfilePoints = NO_PROFILE  # [N]


@dataclass(frozen=True, slots=True, kw_only=True)
class Sheath(Message):
    """Slave to listeners, once a second (late joiners): the shape and constants of one sheath.

    The friction is that in use, which may differ from the calibrated one (`slave.adaptation`).
    """

    tendon: U32 = 0  # which one, from 0
    joint: U32 = 0  # the one it moves, from 0
    sections: U32 = 0  # how many entries of the arrays are in use
    effective_friction: F64 = 0.0  # K
    friction_low: F64 = 0.0  # ends of its interval
    friction_high: F64 = 0.0
    axial_stiffness: F64 = 0.0  # EA [N]
    section_length: Sections = NO_SECTIONS  # [m]
    section_radius: Sections = NO_SECTIONS  # [m] inf = straight


@dataclass(frozen=True, slots=True, kw_only=True)
class Ledger(Message):
    """Master and slave to listeners: the energy ledger of the ports of one side.

    All in tip units, since the process started:
    credit = granted + put_in + received - taken_out - passed_on - dissipated.
    """

    role: U32 = 0  # teleop.messages.topics.Role of the sender
    joints: U32 = 0  # how many entries of the arrays are in use
    credit: Joints = NO_JOINTS  # [J] available now
    put_in: Joints = NO_JOINTS  # [J] work of hand or tip on the network
    taken_out: Joints = NO_JOINTS  # [J] work of the network on hand or tip
    passed_on: Joints = NO_JOINTS  # [J] to the other side
    received: Joints = NO_JOINTS  # [J] from the other side
    dissipated: Joints = NO_JOINTS  # [J] given up
    granted: Joints = NO_JOINTS  # [J] reserves at engagements, and dissipation of hands


@dataclass(frozen=True, slots=True, kw_only=True)
class Event(Message):
    """Any process to all, reliable: a change of session state, or another event."""

    role: U32 = 0  # teleop.messages.topics.Role of the sender
    state: U32 = 0  # teleop.session.state_machine.State of the sender
    reason: U32 = 0  # teleop.session.state_machine.Reason behind it
    text: TextBytes = NO_TEXT  # UTF-8, zero-padded


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopReport(Message):
    """Master and slave to all, twice a second and at the end: timing, losses, messages sent."""

    role: U32 = 0  # teleop.messages.topics.Role of the sender
    state: U32 = 0  # teleop.session.state_machine.State of the sender
    reason: U32 = 0  # teleop.session.state_machine.Reason behind it
    ticks: U64 = 0  # since the loop began
    overruns: U64 = 0  # whole periods skipped
    received: U64 = 0  # of the peer's messages, since the loop began
    lost: U64 = 0  # gaps in the peer's sequence numbers, latest-value overwrites not counted
    rejected: U64 = 0  # corrupted, layout, repeated, out of order, foreign, forged
    corrupted: U64 = 0  # of them: damaged on the way
    repeated: U64 = 0
    out_of_order: U64 = 0
    foreign: U64 = 0  # from another sender while the peer is alive
    forged: U64 = 0  # with a wrong tag
    unknown: U64 = 0  # from a sender without a presence token, or without a tag for us
    delayed: U64 = 0  # too old on arrival
    clock_jumps: U64 = 0  # of the peer's clock
    restarts: U64 = 0  # of the peer's process
    rate_hz: F64 = 0.0  # achieved over the last report's span
    lateness_max_ns: I64 = 0  # the latest tick since the loop began
    latency_p50_ns: I64 = 0  # command to force, over the last report's span (master only)
    latency_p99_ns: I64 = 0  # the same
    ended: U32 = 0  # 1 = the last message of the sender
    sent: TopicCounts = NO_TOPICS  # sequence of its last message of each topic, in their order


@dataclass(frozen=True, slots=True, kw_only=True)
class Latency(Message):
    """Master to all, twice a second: durations of the stages from hand to force since the last.

    Only of commands answered in their own tick. The link stage is both ways together, as one side
    cannot measure one way alone.
    """

    role: U32 = 0  # teleop.messages.topics.Role of the sender
    answered: U64 = 0  # number of commands
    p50_ns: Stages = NO_STAGES  # of each of STAGE_NAMES
    p99_ns: Stages = NO_STAGES
    p99_9_ns: Stages = NO_STAGES
    max_ns: Stages = NO_STAGES


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkReport(Message):
    """Master and slave to all, twice a second: health of the link from the peer.

    Of the last tenth of a second; -1 = not measured. What is below a bound of the config does
    nothing, beyond it `scale` falls, then `holds`.
    """

    role: U32 = 0  # teleop.messages.topics.Role of the sender
    reason: U32 = 0  # teleop.session.state_machine.Reason: the bound that is exceeded, 0 = none
    holds: U32 = 0  # 1 = the session is held because of it
    scale: F64 = 1.0  # of force and motion; the master takes the smaller of both sides'
    offset_ns: I64 = 0  # the peer's clock less the sender's; see `uncertainty_ns`
    uncertainty_ns: I64 = -1  # certified, of the offset
    round_trip_ns: I64 = -1  # mean
    round_trip_max_ns: I64 = -1
    jitter_ns: I64 = -1  # mean difference of the delays of two messages in a row (RFC 3550)
    delay_in_ns: I64 = -1  # from the peer, by the offset
    delay_out_ns: I64 = -1  # to the peer: the rest of the round trip
    age_ns: I64 = -1  # of the peer's newest message
    loss: F64 = -1.0  # share of the peer's messages in the last second
    repeated: U64 = 0  # of the peer's messages, since the loop began
    out_of_order: U64 = 0
    clock_jumps: U64 = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class EmergencyStop(Message):
    """Any process to both sides, reliable: emergency stop, or its reset."""

    role: U32 = 0  # teleop.messages.topics.Role of the sender
    action: U32 = 0  # index into STOP_ACTIONS: a "watch" that times out without "leave" is a stop
    side: U32 = 0  # of a reset: teleop.messages.topics.Role of the side it is for
    number: U32 = 0  # of a reset: `stops` of that side; others are outdated and ignored
    text: TextBytes = NO_TEXT  # UTF-8, zero-padded: sender and reason


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting(Message):
    """Any process to both sides, reliable: change one value of the config of one of them."""

    role: U32 = 0  # teleop.messages.topics.Role of the sender
    key: TextBytes = NO_TEXT  # UTF-8, zero-padded, e.g. operator.position_scale
    value: TextBytes = NO_TEXT  # UTF-8, zero-padded: a number, or axes as in "[0, 2]"


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer(Message):
    """The side of a Setting to its sender, reliable: whether it was accepted."""

    role: U32 = 0  # teleop.messages.topics.Role of the sender
    asker: U64 = 0  # `sender` of the Setting
    setting_sequence: U64 = 0  # `sequence` of the Setting
    accepted: U32 = 0  # 1 = yes
    text: TextBytes = NO_TEXT  # UTF-8, zero-padded: the new value, or the reason of the refusal


MESSAGES: tuple[type[Message], ...] = (
    Command, SlaveState, TendonState, Hand, TensionProfile, Sheath, Ledger, Event, LoopReport,
    Latency, EmergencyStop, Setting, Answer, LinkReport,
)  # fmt: skip

for _cls in MESSAGES:
    _cls.schema = Schema(_cls)

LAYOUT = zlib.crc32(
    "".join(f"{c.schema.name}\n{c.schema.ros_definition}" for c in MESSAGES).encode()
)
