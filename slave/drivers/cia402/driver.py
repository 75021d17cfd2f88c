"""The driver of CiA 402 drives: targets, SYNC, and what the drives answer to it."""

import contextlib
import math
import struct
import time
from collections.abc import Sequence

import can
import numpy as np

from slave.drivers.cia402.bus import SYNC, ClaimedBus, format_bus_name, open_bus, to_driver_fault
from slave.drivers.cia402.codes import format_emergency
from slave.drivers.cia402.config import Cia402Config
from slave.drivers.cia402.drive import (
    FOLLOWING_ERROR,
    INTERPOLATE,
    DriveState,
    NodeSetup,
    RequestedState,
    decode_drive_state,
    select_control_word,
)
from slave.drivers.cia402.monitor import BUS_OFF, BUS_OFF_TEXT, EMERGENCY, HEARTBEAT
from slave.drivers.driver import BusReading, Channels, Counts, DriverFault

TPDO1, TPDO2, RPDO1 = 0x180, 0x280, 0x200
OPERATIONAL, BOOT_UP = 5, 0  # NMT states in a heartbeat
ENABLE_S = 2.0  # [s] in which a drive must be enabled, its brake released
EMERGENCY_S = 0.02  # [s] to wait for the reason of a fault
QUICK_STOPS = 3  # quick stops sent at the end
TOGGLE_BIT = 0x80  # bit of a guarded node's answer, which changes from one to the next
LIMIT = (1 << 31) - 1  # [counts]
_COMMAND, _STATUS = struct.Struct("<Hi"), struct.Struct("<Hi")


class _NodeState:
    """What is known of one node."""

    def __init__(self, number: int, moves: bool, cell: bool) -> None:
        self.number, self.moves, self.has_cell = number, moves, cell
        self.status = 0
        self.position = self.cell = math.nan
        self.answered = False  # in this cycle
        self.heard_s = self.guarded_s = math.inf
        self.toggle = 0  # of the next answer to guarding
        self.emergency = ""
        self.restarted = False

    @property
    def state(self) -> DriveState:
        return decode_drive_state(self.status)


class Cia402Driver:
    """A `BusDriver`; every node samples at SYNC, so readings are of one time."""

    def __init__(self, config: Cia402Config, channels: Channels) -> None:
        self._config, self._channels = config, channels
        self.period_s = 1.0 / config.rate_hz
        numbers = sorted({*channels.motors, *channels.cells})
        self._nodes = {n: _NodeState(n, n in channels.motors, n in channels.cells) for n in numbers}
        self._opened: ClaimedBus | None = None
        self._bus: can.BusABC | None = None
        self._requested = RequestedState.OFF
        self._obeyed = False  # whether all drives were enabled
        self._wanted_s = self._beat_s = math.inf
        self._cycles = self._lost = 0
        self._load = 0.0
        self._began_s = self._sync_s = 0.0
        self._emergencies: dict[str, bool] = {}  # in words, those that stopped nothing, too
        self._guards = config.error_control == "guarding"
        self._cell = struct.Struct("<h" if config.analogue.bits == 16 else "<i")

    def start(self) -> None:
        """Open the bus, set up every node by SDO, start them; the drives are without power."""
        motors, cells = set(self._channels.motors), set(self._channels.cells)
        try:
            self._load = self._config.require_load(len(motors), len(cells), len(motors & cells))
        except ValueError as error:
            raise DriverFault(f"{self._place}: {error}") from error
        self._opened = open_bus(self._config)
        self._bus = self._opened.bus
        monitor, network = self._opened.monitor, self._opened.connect()
        try:
            for node in self._nodes.values():
                network.send_message(0, bytes([0x80, node.number]))  # pre-operational
                set_up = NodeSetup(network, node.number, self._config, monitor)
                if node.moves:
                    set_up.drive(with_cell=node.has_cell)
                else:
                    set_up.set_up_cell()
        except can.CanError as error:
            raise to_driver_fault(self._config, error) from error
        finally:
            if network.notifier is not None:
                network.notifier.stop()
        monitor.forget_errors()
        now = time.monotonic()
        self._send_heartbeat(now)
        for node in self._nodes.values():
            node.heard_s = node.guarded_s = now
            self._send(0, bytes([1, node.number]))  # operational
        self._began_s = now

    def run_cycle(self, target: Counts | None) -> Sequence[BusReading]:
        """Send control words and targets, then SYNC; take the answers."""
        now = time.monotonic()
        if now >= self._beat_s:
            self._send_heartbeat(now)
        if (
            target is not None
            and self._requested is not RequestedState.MOVE
            and not self._is_operating()
        ):
            self._requested, self._wanted_s = RequestedState.MOVE, now
        self._command(target)
        self._sync_s = time.monotonic()
        self._send(SYNC, b"")
        self._cycles += 1
        complete = self._collect(self._sync_s + 0.9 * self.period_s)
        self._check(time.monotonic())
        if not complete:
            self._lost += 1
            return ()
        nodes = self._nodes
        position = np.array([nodes[number].position for number in self._channels.motors])
        cell = np.array([nodes[number].cell for number in self._channels.cells])
        return (BusReading(self._sync_s, position, cell, self._obeyed),)

    def stop(self) -> None:
        """Quick stop, sent by the next cycle: the drives brake by their own ramp and hold.

        No SYNC of its own: its answers would be taken for those of the next one.
        """
        self._requested, self._obeyed = RequestedState.STOP, False

    def summarise(self) -> dict[str, int | float | str]:
        """Return the achieved rate, cycles without every answer, and the load of the bus."""
        span = self._sync_s - self._began_s
        rate = (self._cycles - self._lost) / span if span > 0.0 else 0.0
        reported = {"emergencies": "; ".join(self._emergencies)} if self._emergencies else {}
        return {
            "rate_hz": round(rate, 1),
            "lost_cycles": self._lost,
            "bus_load": round(self._load, 3),
            **reported,
        }

    def close(self) -> None:
        """Quick stop; without our heartbeat the drives do the same by themselves."""
        if self._opened is None:
            return
        with contextlib.suppress(DriverFault, can.CanError, OSError):
            self._requested = RequestedState.STOP
            for _ in range(QUICK_STOPS if self._began_s else 0):
                self._command(None)
                self._send(SYNC, b"")
                self._collect(time.monotonic() + self.period_s)
        with contextlib.suppress(can.CanError, OSError):
            self._opened.shutdown()
        self._opened = self._bus = None

    @property
    def _place(self) -> str:
        return format_bus_name(self._config)

    def _is_operating(self) -> bool:
        """Return whether a drive still says that it is enabled, a cycle after a quick stop."""
        nodes = (self._nodes[number] for number in self._channels.motors)
        return any(node.state is DriveState.OPERATION_ENABLED for node in nodes)

    def _command(self, target: Counts | None) -> None:
        """Send each drive its control word, and its target or the position where it is."""
        targets = [math.nan] * len(self._channels.motors) if target is None else target.tolist()
        for number, value in zip(self._channels.motors, targets, strict=True):
            node = self._nodes[number]
            word = select_control_word(node.state, self._requested)
            moving = (
                node.state is DriveState.OPERATION_ENABLED
                and self._requested is RequestedState.MOVE
            )
            if self._config.mode == "interpolation" and moving:
                word |= INTERPOLATE
            goal = value if moving and math.isfinite(value) else node.position
            counts = max(-LIMIT, min(LIMIT, round(goal))) if math.isfinite(goal) else 0
            self._send(RPDO1 + number, _COMMAND.pack(word, counts))

    def _collect(self, until_s: float) -> bool:
        """Receive until every node has answered or the time is over; return whether all have."""
        for node in self._nodes.values():
            node.answered = False
        while (left_s := until_s - time.monotonic()) > 0.0:
            message = self._receive(left_s)
            if message is not None:
                self._take(message)
            if all(node.answered for node in self._nodes.values()):
                return True
        return False

    def _take(self, message: can.Message) -> None:
        if message.is_error_frame:
            if message.arbitration_id & BUS_OFF:
                raise DriverFault(f"{self._place}: {BUS_OFF_TEXT}")
            if self._opened is not None:
                self._opened.monitor.on_message_received(message)
            return
        if message.is_extended_id:  # no identifier of CANopen
            return
        identifier, data = message.arbitration_id, bytes(message.data)
        node = self._nodes.get(identifier & 0x7F)
        if node is None:
            return
        kind = identifier & 0x780
        if kind == TPDO1 and len(data) >= _STATUS.size:
            node.status, position = _STATUS.unpack_from(data)
            node.position = float(position)
            if len(data) > _STATUS.size:
                node.cell = float(self._cell.unpack_from(data, _STATUS.size)[0])
        elif kind == TPDO2 and len(data) == self._cell.size:
            node.cell = float(self._cell.unpack(data)[0])
        elif kind == EMERGENCY and len(data) >= 2:
            code = int.from_bytes(data[:2], "little")
            node.emergency = format_emergency(code) if code else ""
            if code:
                self._emergencies[f"drive {node.number}: {node.emergency}"] = True
            return
        elif kind == HEARTBEAT and data[:1] == bytes([BOOT_UP]):
            node.restarted = True
            return
        elif kind == HEARTBEAT and data and data[0] & TOGGLE_BIT == node.toggle:
            node.guarded_s, node.toggle = time.monotonic(), node.toggle ^ TOGGLE_BIT
            return
        else:
            return
        node.heard_s = time.monotonic()
        last = TPDO1 if node.moves and (not node.has_cell or self._cell.size == 2) else TPDO2
        node.answered = kind == last

    def _check(self, now: float) -> None:
        """Raise `DriverFault` for what the nodes report or fail to."""
        following = bool(self._channels.motors)
        for node in self._nodes.values():
            if node.restarted:
                raise DriverFault(f"drive {node.number} has restarted: its supply failed?")
            silent = now - node.heard_s
            if silent > self._config.timeout:
                reason = self._opened.monitor.explain_errors() if self._opened else ""
                raise DriverFault(
                    f"{self._place}: node {node.number} silent for {silent * 1e3:.0f} ms"
                    f"{': ' * bool(reason)}{reason}"
                )
            if not node.moves:
                continue
            if self._guards and now - node.guarded_s > self._config.timeout:
                raise DriverFault(
                    f"drive {node.number} does not answer node guarding: if it has none, set "
                    "error_control to heartbeat"
                )
            state = node.state
            if state in (DriveState.FAULT, DriveState.FAULT_REACTION):
                raise DriverFault(f"drive {node.number}: {self._describe_reason(node)}")
            if self._requested is RequestedState.MOVE and state is DriveState.OPERATION_ENABLED:
                if node.status & FOLLOWING_ERROR:
                    raise DriverFault(f"drive {node.number}: following error")
                continue
            following = False
            if self._requested is RequestedState.MOVE and self._obeyed:
                raise DriverFault(
                    f"drive {node.number} has left operation by itself: {state.text}"
                    f"{', ' * bool(node.emergency)}{node.emergency}"
                )
            if self._requested is RequestedState.MOVE and now - self._wanted_s > ENABLE_S:
                raise DriverFault(f"drive {node.number} cannot be enabled: {state.text}")
        self._obeyed = self._obeyed or (following and self._requested is RequestedState.MOVE)

    def _describe_reason(self, node: _NodeState) -> str:
        """Return why a drive has a fault; its emergency message may come after the status word."""
        until_s = time.monotonic() + EMERGENCY_S
        while not node.emergency and (left_s := until_s - time.monotonic()) > 0.0:
            message = self._receive(left_s)
            if message is not None:
                self._take(message)
        return f"fault: {node.emergency or 'reason unknown'}"

    def _send_heartbeat(self, now: float) -> None:
        """Send our heartbeat, or ask each guarded drive for its state."""
        self._beat_s = now + self._config.beat_s
        if self._guards:
            for number in self._channels.motors:
                self._send(HEARTBEAT + number, None)
        else:
            self._send(HEARTBEAT + self._config.master, bytes([OPERATIONAL]))

    def _send(self, identifier: int, data: bytes | None) -> None:
        """Send a message; without data a remote frame, which asks for one byte."""
        if self._bus is None:
            return
        message = can.Message(
            arbitration_id=identifier,
            data=data,
            dlc=1 if data is None else len(data),
            is_remote_frame=data is None,
            is_extended_id=False,
        )
        try:
            self._bus.send(message)
        except (can.CanError, OSError) as error:
            raise to_driver_fault(self._config, error) from error

    def _receive(self, timeout_s: float) -> can.Message | None:
        if self._bus is None:
            return None
        try:
            return self._bus.recv(timeout_s)
        except (can.CanError, OSError) as error:
            raise to_driver_fault(self._config, error) from error
