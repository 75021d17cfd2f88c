"""CiA 402 drives: the CANopen stack is `durand`, which knows nothing of this project.

On it a small state machine written from the profile's tables, the following error, the quick stop,
the consumer of our heartbeat, and a plant.
"""

import math
import time
from contextlib import suppress

import can
from durand import Node, Record, Variable
from durand.datatypes import DatatypeEnum as Kind
from durand.network import NetworkABC
from durand.node import NodeCapabilities
from durand.object_dictionary import Array
from durand.scheduler import VirtualScheduler, set_scheduler

from studies.rigs.models.line import BusThread
from studies.rigs.models.plant import ZERO, Springs

NOT_READY, DISABLED, READY, ON, ENABLED, QUICK_STOP, REACTION, FAULT = (
    0x00, 0x40, 0x21, 0x23, 0x27, 0x07, 0x0F, 0x08,
)  # fmt: skip
HOMED = 1 << 15
HEARTBEAT_LOST, FOLLOWING = 0x8130, 0x8611
SLICE_S = 0.010  # [s] of the stack's timers at once
ROUND_S = 0.0005  # [s] between two looks at the plant
FOLLOWING_MODES = (7, 8)  # of 6060, in which a drive follows its target at once


class Subscriptions(NetworkABC):
    """The part of the bus that one node sees."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus, self.callbacks = bus, {}

    def add_subscription(self, cob_id, callback) -> None:
        self.callbacks[cob_id] = callback

    def remove_subscription(self, cob_id) -> None:
        self.callbacks.pop(cob_id, None)

    def send(self, cob_id, msg) -> None:
        message = can.Message(arbitration_id=cob_id, data=msg, is_extended_id=False)
        with suppress(can.CanOperationError):  # a cable that is cut carries nothing
            self._bus.send(message)


class Drive:
    """One node with its state machine; positions in counts."""

    def __init__(self, bus: can.BusABC, number: int, patience: float) -> None:
        self.number, self._patience = number, patience
        self.network = Subscriptions(bus)
        self.node = Node(self.network, number, capabilities=NodeCapabilities(1, 4, 4))
        self.state = DISABLED
        self.homed = HOMED
        self.obeys = True  # whether the motor follows
        self.enable_s = 0.0  # [s] from switched on to enabled, of a brake for example
        self._on_s = 0.0
        self.disable_s = 0.0  # [s] from disable voltage to no power, of a brake for example
        self._off_due_s = math.inf
        self.lost = []  # control words that it does not get, each once
        self.beat_s = 0.0
        self.guards = True  # whether it answers node guarding
        self._toggle, self._guarded = 0, False
        self.stopped_s = 0.0
        self._off_s = 0.0
        od = self.node.object_dictionary
        self.od = od
        for index, *variable in (
            (0x100C, Kind.UNSIGNED16, "rw", 0),
            (0x100D, Kind.UNSIGNED8, "rw", 0),
            (0x603F, Kind.UNSIGNED16, "ro", 0),
            (0x6007, Kind.INTEGER16, "rw", 1),
            (0x6040, Kind.UNSIGNED16, "rw", 0),
            (0x6041, Kind.UNSIGNED16, "ro", DISABLED | HOMED),
            (0x605A, Kind.INTEGER16, "rw", 2),
            (0x6060, Kind.INTEGER8, "rw", 0),
            (0x6064, Kind.INTEGER32, "ro", round(ZERO)),
            (0x6065, Kind.UNSIGNED32, "rw", 2000),
            (0x6066, Kind.UNSIGNED16, "rw", 0),
            (0x607A, Kind.INTEGER32, "rw", 0),
            (0x607F, Kind.UNSIGNED32, "rw", 1000),
            (0x6085, Kind.UNSIGNED32, "rw", 1000),
            (0x6502, Kind.UNSIGNED32, "ro", 1 << 7 | 1 << 6),
        ):
            od[index] = Variable(*variable)
        od[0x1000] = Variable(Kind.UNSIGNED32, "ro", 0x0002_0192)
        od[0x1008] = Variable(Kind.VISIBLE_STRING, "ro", b"model of a drive")
        od[0x1016] = Array(Variable(Kind.UNSIGNED32, "rw", 0), 1)
        for index, entries in (
            (0x607D, {1: (Kind.INTEGER32, "rw", 0), 2: (Kind.INTEGER32, "rw", 0)}),
            (0x60C1, {1: (Kind.INTEGER32, "rw", 0)}),
            (0x60C2, {1: (Kind.UNSIGNED8, "rw", 1), 2: (Kind.INTEGER8, "rw", -3)}),
            (0x3160, {1: (Kind.INTEGER16, "ro", 0)}),
        ):
            od[index] = record = Record()
            for subindex, variable in entries.items():
                record[subindex] = Variable(*variable)
        od.download_callbacks[(0x6040, 0)].add(self._control)
        self._last_word = 0

    @property
    def powered(self) -> bool:
        return self.follows and self.obeys

    @property
    def follows(self) -> bool:
        """Whether it is enabled in a mode in which targets act by themselves."""
        return self.state == ENABLED and self.od.read(0x6060, 0) in FOLLOWING_MODES

    @property
    def target(self) -> int:
        return self.od.read(0x60C1, 1) if self.od.read(0x6060, 0) == 7 else self.od.read(0x607A, 0)

    def fail(self, code: int) -> None:
        self.od.write(0x603F, 0, code)
        self._enter(FAULT)
        self.node.emcy.set(code, 1)

    def guarded(self, identifier: int, now: float) -> None:
        """Answer a remote frame of node guarding; the first one begins the life time."""
        if identifier != 0x700 + self.number or not self.guards:
            return
        self.beat_s, self._guarded = now, True
        self.network.send(identifier, bytes([self._toggle | self.node.nmt.state]))
        self._toggle ^= 0x80

    @property
    def patience_s(self) -> float:
        """Time [s] without heartbeat or guarding after which it stops; 0: none."""
        if self._guarded:
            return self.od.read(0x100C, 0) * self.od.read(0x100D, 0) * 1e-3
        return (self.od.read(0x1016, 1) & 0xFFFF) * 1e-3

    def hear(self, identifier: int, data: bytes, now: float) -> None:
        consumed = self.od.read(0x1016, 1)
        if identifier == 0x700 + (consumed >> 16 & 0x7F):
            self.beat_s = now
        callback = self.network.callbacks.get(identifier)
        if callback is not None:
            callback(identifier, data)

    def advance(self, position: float, cell: float, now: float) -> None:
        """Take the plant's values, and watch heartbeat and following error."""
        self.od.write(0x6064, 0, round(position))
        self.od.write(0x3160, 1, max(-32768, min(32767, round(cell))))
        if now >= self._off_due_s:
            self._enter(DISABLED)
        limit_s = self.patience_s * self._patience
        if self.state == ENABLED and limit_s and now - self.beat_s > limit_s:
            self.stopped_s = now
            self._enter(QUICK_STOP)
            self.node.emcy.set(HEARTBEAT_LOST, 0x10)
        near = abs(self.target - position) <= self.od.read(0x6065, 0)
        if not self.follows or near:
            self._off_s = now
        elif now - self._off_s > self.od.read(0x6066, 0) * 1e-3:
            self.fail(FOLLOWING)

    def _control(self, word: int) -> None:
        if word in self.lost:
            self.lost.remove(word)
            return
        rising = word & ~self._last_word
        self._last_word = word
        state = self.state
        if state == FAULT:
            if rising & 0x80:
                self.od.write(0x603F, 0, 0)
                self._enter(DISABLED)
        elif not word & 0x02:  # disable voltage
            if state in (ENABLED, QUICK_STOP) and self.disable_s:
                self._off_due_s = min(self._off_due_s, time.monotonic() + self.disable_s)
            else:
                self._enter(DISABLED)
        elif not word & 0x04:  # quick stop
            if state in (READY, ON):
                self._enter(DISABLED)
            elif state == ENABLED:
                self._enter(QUICK_STOP)
        elif word & 0x0F == 0x06 and state in (DISABLED, ON, ENABLED):
            self._enter(READY)
        elif word & 0x0F == 0x07 and state in (READY, ENABLED):
            self._enter(ON)
        elif word & 0x0F == 0x0F and state == ON and time.monotonic() >= self._on_s + self.enable_s:
            self._enter(ENABLED)

    def _enter(self, state: int) -> None:
        self.state, self._off_due_s = state, math.inf
        if state == ON:
            self._on_s = time.monotonic()
        if state == ENABLED:
            self._off_s = time.monotonic()
        self.od.write(0x6041, 0, state | self.homed)


class Drives(BusThread):
    """Drives on one bus with their plant; `serve` runs until `ended` is set.

    They wait `patience` times as long for our heartbeat as told, for a busy machine.
    """

    def __init__(self, bus: can.BusABC, numbers=(1,), plant=None, patience: float = 10.0) -> None:
        self.bus = bus
        self._scheduler = VirtualScheduler()
        set_scheduler(self._scheduler)
        self.drives = [Drive(bus, number, patience) for number in numbers]
        self.plant = plant or Springs(len(self.drives))
        self.silent = self.unplug = False
        self._start_s = time.monotonic()

    def serve(self) -> None:
        last_s = due_s = time.monotonic()
        while not self.ended:
            if self.unplug:
                self.bus.port.unplug()
            message = self._receive(max(0.0, min(ROUND_S, due_s - time.monotonic())))
            now = time.monotonic()
            if message is not None and not self.silent:
                for drive in self.drives:
                    if message.is_remote_frame:
                        drive.guarded(message.arbitration_id, now)
                    else:
                        drive.hear(message.arbitration_id, bytes(message.data), now)
            if now < due_s:
                continue
            due_s = now + ROUND_S
            self._advance(now)
            while last_s < now and not self.silent:  # it never ends a run beyond one heartbeat
                self._scheduler.run(min(SLICE_S, now - last_s))
                last_s += SLICE_S

    def _receive(self, wait_s: float) -> can.Message | None:
        try:
            return self.bus.recv(wait_s)
        except can.CanOperationError:  # the interface is down; the drives themselves go on
            time.sleep(wait_s)
            return None

    def _advance(self, now: float) -> None:
        self.plant.advance(
            now - self._start_s,
            [drive.target for drive in self.drives],
            [drive.powered for drive in self.drives],
        )
        cells = self.plant.read_cells()
        for drive, position, cell in zip(self.drives, self.plant.position, cells, strict=True):
            drive.advance(position, cell, now)


class SlcanAdapter(can.BusABC):
    """A bus whose near end is an slcan adapter on a pty: 't', identifier, length, data, return."""

    def __init__(self, port) -> None:
        self.port = port
        self._received = b""
        self._open = False
        super().__init__(channel="slcan model")

    def _recv_internal(self, timeout):
        end_s = time.monotonic() + (timeout or 0.0)
        while b"\r" not in self._received:
            left_s = end_s - time.monotonic()
            if left_s <= 0.0:
                return None, False
            self._received += self.port.read(left_s)
        line, _, self._received = self._received.partition(b"\r")
        if line[:1] in (b"O", b"C"):
            self._open = line[:1] == b"O"
        if line[:1] not in (b"t", b"r") or not self._open:
            return None, False
        remote, length = line[:1] == b"r", int(line[4:5])
        data = None if remote else bytes.fromhex(line[5 : 5 + 2 * length].decode())
        identifier = int(line[1:4], 16)
        message = can.Message(
            arbitration_id=identifier,
            data=data,
            dlc=length,
            is_remote_frame=remote,
            is_extended_id=False,
        )
        return message, False

    def send(self, msg, timeout=None) -> None:  # noqa: ARG002 - of the base class
        if self._open:
            text = f"t{msg.arbitration_id:03X}{msg.dlc}{bytes(msg.data).hex().upper()}\r"
            self.port.write(text.encode())

    def shutdown(self) -> None:
        super().shutdown()
        self.port.unplug()
