"""One CiA 402 drive: its state machine, and its set-up by SDO."""

import contextlib
import struct
import time
from collections.abc import Iterator
from enum import Enum, IntEnum

import canopen
from canopen.sdo.exceptions import SdoAbortedError, SdoError

from slave.drivers.cia402.codes import format_abort, format_emergency
from slave.drivers.cia402.config import HEARTBEATS_PER_TIMEOUT, Cia402Config
from slave.drivers.cia402.monitor import BusMonitor
from slave.drivers.driver import DriverFault


class DriveState(Enum):
    """States of a drive; the value is (mask, pattern) of the status word."""

    NOT_READY = (0x4F, 0x00)
    SWITCH_ON_DISABLED = (0x4F, 0x40)
    READY_TO_SWITCH_ON = (0x6F, 0x21)
    SWITCHED_ON = (0x6F, 0x23)
    OPERATION_ENABLED = (0x6F, 0x27)
    QUICK_STOP_ACTIVE = (0x6F, 0x07)
    FAULT_REACTION = (0x4F, 0x0F)
    FAULT = (0x4F, 0x08)

    @property
    def text(self) -> str:
        """Name for messages."""
        return self.name.replace("_", " ").lower()


class ControlWord(IntEnum):
    """Control words."""

    DISABLE_VOLTAGE = 0x00
    QUICK_STOP = 0x02
    SHUTDOWN = 0x06
    SWITCH_ON = 0x07
    ENABLE_OPERATION = 0x0F
    RESET_FAULT = 0x80


class RequestedState(Enum):
    """What a drive is wanted to do."""

    OFF = 0  # without power
    MOVE = 1  # follow targets
    STOP = 2  # stop by its own ramp and hold


FOLLOWING_ERROR = 1 << 13  # of the status word, in the modes used here
INTERPOLATE = 1 << 4  # of the control word, in interpolated mode

_TO_MOVE = {
    DriveState.SWITCH_ON_DISABLED: ControlWord.SHUTDOWN,
    DriveState.READY_TO_SWITCH_ON: ControlWord.SWITCH_ON,
    DriveState.SWITCHED_ON: ControlWord.ENABLE_OPERATION,
    DriveState.OPERATION_ENABLED: ControlWord.ENABLE_OPERATION,
    DriveState.QUICK_STOP_ACTIVE: ControlWord.DISABLE_VOLTAGE,
}


def decode_drive_state(status_word: int) -> DriveState:
    """Return the state that a status word tells."""
    for state in DriveState:
        mask, pattern = state.value
        if status_word & mask == pattern:
            return state
    return DriveState.NOT_READY


def select_control_word(state: DriveState, requested: RequestedState) -> int:
    """Return the control word that takes a drive one step towards what is wanted.

    A fault is never reset here: that is the operator's.
    """
    if requested is RequestedState.MOVE:
        return int(_TO_MOVE.get(state, ControlWord.DISABLE_VOLTAGE))
    if requested is RequestedState.STOP and state in (
        DriveState.OPERATION_ENABLED,
        DriveState.QUICK_STOP_ACTIVE,
    ):
        return int(ControlWord.QUICK_STOP)
    return int(ControlWord.DISABLE_VOLTAGE)


# --- set up a CANopen node by SDO: PDOs, modes, limits, watchdog; each value is read back

SDO_TIMEOUT_S = 0.3
TWIN_S = 0.005  # [s] in which the answer of a second node of one number has come
TWINS_TEXT = "two nodes have this number: connect one at a time and change its number"
LATE_S = 0.5  # [s] after which an answer that is late has come
HEARTBEAT_MS = 100  # of the nodes
DISABLE_S = 1.0  # [s] in which a drive must be without power, its brake closed
POLL_S = 0.02  # [s] between two requests of the status word
_POWERED = (DriveState.OPERATION_ENABLED, DriveState.QUICK_STOP_ACTIVE, DriveState.FAULT_REACTION)
_MODES = {"position": (8, 7), "interpolation": (7, 6)}  # value of 6060, bit of 6502
_OFF = 1 << 31  # of a PDO's identifier
_NO_OBJECT = (0x06020000, 0x06090011)  # abort codes: no such object, no such subindex
_POSITION_SETTINGS = (  # object, bits that must be 0, what they do
    (0x607E, 0x80, "reversed positions"),
    (0x60B0, 0xFFFFFFFF, "an offset of its targets"),
)
SYNCHRONOUS = 1  # transmission type: at every SYNC
QUICK_STOP_AND_HOLD = 6  # of 605A
QUICK_STOP_ON_LOSS = 3  # of 6007


class NoAnswer(DriverFault):
    """A node does not answer SDO requests."""


class NodeSetup:
    """One node while it is set up, in the state pre-operational."""

    def __init__(
        self,
        network: canopen.Network,
        number: int,
        config: Cia402Config,
        monitor: BusMonitor,
        timeout_s: float = SDO_TIMEOUT_S,
    ) -> None:
        self._config, self._number, self._monitor = config, number, monitor
        node = network.add_node(number, canopen.ObjectDictionary())
        self._sdo = node.sdo
        self._sdo.RESPONSE_TIMEOUT = timeout_s

    def require_single(self) -> None:
        """Raise `DriverFault` if two nodes have this number: both answer each request."""
        for _ in range(2):  # one answer may be a late one to an earlier request
            self._monitor.forget_answers(self._number)
            self.get(0x1000, 0)
            time.sleep(TWIN_S)
            if self._monitor.count_answers(self._number) < 2:
                return
        raise self._build_fault(f"answers each request twice: {TWINS_TEXT}")

    def drive(self, with_cell: bool) -> None:
        """Set up a drive, without power; `DriverFault` if it refuses, has a fault or no home."""
        self.require_drive()
        config = self._config
        mode, bit = _MODES[config.mode]
        if not self.get(0x6502, 0) >> bit & 1:
            raise self._build_fault(f"has no mode '{config.mode}' (object 6502)")
        self._disable()
        self.put(0x6060, 0, 1, mode, signed=True)
        self.put(0x6065, 0, 4, config.following_error)
        self.put(0x6066, 0, 2, round(config.following_time * 1e3))
        self.put(0x607D, 1, 4, config.position_min, signed=True)
        self.put(0x607D, 2, 4, config.position_max, signed=True)
        self.put(0x607F, 0, 4, config.velocity_max)
        self.put(0x6085, 0, 4, config.quick_stop_deceleration)
        self.put(0x605A, 0, 2, QUICK_STOP_AND_HOLD, signed=True)
        self.put(0x6007, 0, 2, QUICK_STOP_ON_LOSS, signed=True)
        count, exponent = config.period
        self.put(0x60C2, 1, 1, count)
        self.put(0x60C2, 2, 1, exponent, signed=True)
        self._set_up_error_control()
        target = (0x60C1, 1, 32) if config.mode == "interpolation" else (0x607A, 0, 32)
        self._map(0x1400, 0x200, [(0x6040, 0, 16), target])
        cell = self._find_cell()
        sent = [(0x6041, 0, 16), (0x6064, 0, 32)]
        cell_in_drive = with_cell and cell[2] == 16
        self._map(0x1800, 0x180, [*sent, cell] if cell_in_drive else sent)
        self._map(0x1801, 0x280, [cell] if with_cell and not cell_in_drive else [])

    def set_up_cell(self) -> None:
        """Set up a node that has a load cell and no motor in use."""
        self.require_single()
        self.put(0x1017, 0, 2, HEARTBEAT_MS)
        self._map(0x1800, 0x180, [])
        self._map(0x1801, 0x280, [self._find_cell()])

    def reset_fault(self) -> DriveState:
        """Reset a fault by the rising edge of its bit; return the state after it."""
        self.put(0x6040, 0, 2, ControlWord.DISABLE_VOLTAGE, check=False)
        self.put(0x6040, 0, 2, ControlWord.RESET_FAULT, check=False)
        self.put(0x6040, 0, 2, ControlWord.DISABLE_VOLTAGE, check=False)
        return decode_drive_state(self.get(0x6041, 0))

    def describe(self) -> str:
        """Return name, profile and state, as far as the node tells."""
        profile = self.get(0x1000, 0) & 0xFFFF
        self._sdo.RESPONSE_TIMEOUT = SDO_TIMEOUT_S  # it is there
        self.require_single()
        name = ""
        with contextlib.suppress(SdoError):
            name = self._sdo.upload(0x1008, 0).rstrip(b"\0").decode("ascii", "replace")
        state = f", {decode_drive_state(self.get(0x6041, 0)).text}" if profile == 402 else ""
        return f"node {self._number}: {name or 'no name'}, profile {profile}{state}"

    def get(self, index: int, subindex: int, signed: bool = False) -> int:
        """Read a value; `DriverFault` if the node has none."""
        with self._translate_errors(f"object {index:04X}:{subindex}"):
            return int.from_bytes(self._sdo.upload(index, subindex), "little", signed=signed)

    def _get_if_there(self, index: int) -> int:
        """Read an unsigned value; 0 if the node has no such object, `DriverFault` if it refuses."""
        with self._translate_errors(f"object {index:04X}:0"):
            try:
                return int.from_bytes(self._sdo.upload(index, 0), "little")
            except SdoAbortedError as error:
                if error.code not in _NO_OBJECT:
                    raise
                return 0

    def put(
        self,
        index: int,
        subindex: int,
        size: int,
        value: int,
        check: bool = True,
        signed: bool = False,
        meaning: str = "",
    ) -> None:
        """Write a value of `size` bytes, or its `meaning` in messages, and read it back.

        `DriverFault` if the value does not fit `size` bytes, in two's complement if `signed`, or
        the node does not take it.
        """
        try:
            data = int(value).to_bytes(size, "little", signed=signed)
        except OverflowError as error:
            kind = f"{8 * size} bits, {'signed' if signed else 'unsigned'}"
            raise self._build_fault(
                f"object {index:04X}:{subindex}: {value} does not fit {kind}"
            ) from error
        with self._translate_errors(f"object {index:04X}:{subindex} = {meaning or value}"):
            self._sdo.download(index, subindex, data)
            readback = self._sdo.upload(index, subindex) if check else data
        if readback[:size] != data:
            read = int.from_bytes(readback[:size], "little", signed=signed)
            raise self._build_fault(
                f"object {index:04X}:{subindex}: set to {meaning or value}, reads back {read}"
            )

    def require_drive(self) -> None:
        """Raise `DriverFault` if the node is no drive, has a fault or is not homed; read only."""
        self.require_single()
        if self.get(0x1000, 0) & 0xFFFF != 402:
            raise self._build_fault("is no CiA 402 drive (object 1000)")
        status = self.get(0x6041, 0)
        if decode_drive_state(status) in (DriveState.FAULT, DriveState.FAULT_REACTION):
            code = format_emergency(self.get(0x603F, 0))
            raise self._build_fault(
                f"has a fault: {code}; remove its cause, then `teleop rig reset`"
            )
        bit = self._config.homed_bit
        if bit is not None and not status >> bit & 1:
            raise self._build_fault(
                f"is not homed (bit {bit} of its status word): home it by its own tool, or set "
                "homed_bit to null if its encoder is absolute"
            )
        for index, bits, text in _POSITION_SETTINGS:
            value = self._get_if_there(index)
            if value & bits:
                raise self._build_fault(
                    f"has {text} (object {index:04X} is 0x{value:X}): set it to 0 by its own tool"
                )

    def _disable(self) -> None:
        """Take the drive's power off: enabled, it would go to an old target in the new mode."""
        self.put(0x6040, 0, 2, ControlWord.DISABLE_VOLTAGE, check=False)
        until_s = time.monotonic() + DISABLE_S
        while (state := decode_drive_state(self.get(0x6041, 0))) in _POWERED:
            if time.monotonic() > until_s:
                raise self._build_fault(
                    f"is still {state.text} {DISABLE_S:g} s after disable voltage (object 6040): "
                    "disable it by its own tool; its mode and limits were not changed"
                )
            time.sleep(POLL_S)

    def _set_up_error_control(self) -> None:
        """Set up how the drive notices that this side is gone."""
        config = self._config
        if config.error_control == "guarding":
            self.put(0x1017, 0, 2, 0)  # a node that sends heartbeats cannot be guarded
            self.put(0x100C, 0, 2, int(config.beat_s * 1e3))
            self.put(0x100D, 0, 1, HEARTBEATS_PER_TIMEOUT)
        else:
            self.put(0x1017, 0, 2, HEARTBEAT_MS)
            self.put(0x1016, 1, 4, config.master << 16 | round(config.watchdog * 1e3))

    def _find_cell(self) -> tuple[int, int, int]:
        analogue = self._config.analogue
        return analogue.index, analogue.subindex, analogue.bits

    def _map(self, index: int, base: int, objects: list[tuple[int, int, int]]) -> None:
        """Map objects (index, subindex, bits) to the PDO of communication object `index`.

        The order is that of CiA 301: PDO off, mapping off, objects, their number, PDO on.
        """
        identifier = base + self._number
        with self._translate_errors(f"object {index:04X}:1"):
            try:
                self._sdo.download(index, 1, struct.pack("<I", identifier | _OFF))
            except SdoAbortedError as error:
                if objects or error.code not in _NO_OBJECT:
                    raise
                return
        self.put(index + 0x200, 0, 1, 0)
        if not objects:
            return
        self.put(index, 2, 1, SYNCHRONOUS)
        for k, (mapped, subindex, bits) in enumerate(objects, 1):
            entry = f"{mapped:04X}:{subindex}, {bits} bits"
            self.put(index + 0x200, k, 4, mapped << 16 | subindex << 8 | bits, meaning=entry)
        self.put(index + 0x200, 0, 1, len(objects))
        self.put(index, 1, 4, identifier)

    @contextlib.contextmanager
    def _translate_errors(self, place: str) -> Iterator[None]:
        """Have a refusal, or a missing answer, of the node as a `DriverFault` with the reason."""
        try:
            yield
        except SdoAbortedError as error:
            raise self._build_fault(f"{place}: {format_abort(error)}") from error
        except SdoError as error:
            if "instead" in str(error):  # the answer is of another object
                raise self._build_fault(
                    f"{place}: an answer to another request came: another program speaks to it, or "
                    f"{TWINS_TEXT}"
                ) from error
            if "No SDO response" not in str(error):
                raise self._build_fault(f"{place}: {error}") from error
            self._monitor.forget_answers(self._number)
            timeout_s = self._sdo.RESPONSE_TIMEOUT
            until_s = time.monotonic() + (LATE_S if timeout_s == SDO_TIMEOUT_S else 0.0)
            while time.monotonic() < until_s and not self._monitor.count_answers(self._number):
                time.sleep(POLL_S)
            reason = self._monitor.explain_silence(self._number, timeout_s)
            raise NoAnswer(f"drive {self._number} {reason}") from error

    def _build_fault(self, text: str) -> DriverFault:
        return DriverFault(f"drive {self._number} {text}")
