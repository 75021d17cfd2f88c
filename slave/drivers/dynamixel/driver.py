"""The driver of Dynamixel servos: one sync read and one sync write a cycle, by the vendor's SDK."""

import contextlib
import math
import termios
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
import serial
from dynamixel_sdk import GroupSyncRead, GroupSyncWrite, PacketHandler

from slave.drivers.driver import Channels, Counts, DriverFault, Reading
from slave.drivers.dynamixel import registers
from slave.drivers.dynamixel.config import WATCHDOG_UNIT, DynamixelConfig
from slave.drivers.dynamixel.port import WaitingPort, result_text
from slave.drivers.dynamixel.registers import STATUS_SIZE, Register, Status

Result = TypeVar("Result")

TRIES = 5  # of a single register
NEAR = 20  # [counts] of a goal from the position, when torque is switched on
ENABLE_S = 0.5  # [s] in which torque must be on
LIMIT = (1 << 31) - 1  # [counts]


class DynamixelDriver:
    """A `slave.drivers.driver.Driver`; a cell's reading is the present current of that servo [A].

    The goal is set to the present position before torque is enabled. Each servo's bus watchdog
    stops it when instructions cease; then it refuses goals, and this is a fault.
    """

    def __init__(self, config: DynamixelConfig, channels: Channels) -> None:
        self._config, self._channels = config, channels
        self._ids = sorted({*channels.motors, *channels.cells})
        self.period_s = 1.0 / config.rate_hz
        self._port = WaitingPort(config.port, config.wait)
        self._packets = PacketHandler(2.0)
        self._read = GroupSyncRead(self._port, self._packets, registers.INDIRECT_DATA, STATUS_SIZE)
        for number in self._ids:
            self._read.addParam(number)
        self._motor_rows = [self._ids.index(number) for number in channels.motors]
        self._cell_rows = [self._ids.index(number) for number in channels.cells]
        self._watchdog = round(config.watchdog / WATCHDOG_UNIT)
        self._enabled = False
        self._positions: list[int] = []  # of the motors, read last
        self._wanted_s = math.inf
        self._cycles = self._lost = 0
        self._began_s = self._heard_s = 0.0

    def start(self) -> None:
        """Open the port; set up every servo and check it. Torque is off afterwards."""
        try:
            self._port.openPort()
            opened = self._port.setBaudRate(self._config.baud)
        except (serial.SerialException, OSError, ValueError) as error:
            raise DriverFault(f"{self._config.port}: cannot be opened: {error}") from error
        if not opened:
            raise DriverFault(f"{self._config.port}: the SDK has no baud rate {self._config.baud}")
        self._call(self._set_up_all)
        self._began_s = self._heard_s = time.monotonic()

    def cycle(self, target: Counts | None) -> Sequence[Reading]:
        """Send the goals, read position, current and status of every servo."""
        return self._call(lambda: self._exchange(target))

    def stop(self) -> None:
        """Torque off; `cycle` repeats it until every servo confirms it."""
        self._enabled = False
        off = [0] * len(self._channels.motors)
        self._call(lambda: self._send(registers.TORQUE_ENABLE, off))

    def counts(self) -> dict[str, int | float]:
        """Return the achieved rate, and the reads without an answer of every servo."""
        span = self._heard_s - self._began_s
        answered = self._cycles - self._lost
        return {
            "rate_hz": round(answered / span, 1) if span > 0.0 else 0.0,
            "lost_reads": self._lost,
        }

    def close(self) -> None:
        """Stop the servos where they are, by their goals and then their watchdogs; torque holds."""
        if self._port.ser is None:
            return
        with contextlib.suppress(serial.SerialException, termios.error, OSError):
            if self._enabled or self._wanted_s < math.inf:  # or about to be
                self._send(registers.GOAL_POSITION, self._positions)
                self._send(registers.BUS_WATCHDOG, [1] * len(self._positions))
        with contextlib.suppress(serial.SerialException, OSError):
            self._port.closePort()

    def _call(self, action: Callable[[], Result]) -> Result:
        """Call with the errors of an unplugged adapter as a `DriverFault`."""
        try:
            return action()
        except (serial.SerialException, termios.error, OSError) as error:
            raise DriverFault(f"{self._config.port}: unplugged ({error})") from error

    def _set_up_all(self) -> None:
        for number in self._ids:
            self._set_up(number)

    def _set_up(self, number: int) -> None:
        """Set up one servo, torque off: the order matters, its EEPROM is locked with torque on."""
        model, text = self._ping(number)
        if text:
            raise DriverFault(
                f"{self._config.port}: servo {number}: {text} at {self._config.baud} baud; "
                "`teleop rig scan` lists what is there"
            )
        error = self._get(number, registers.HARDWARE_ERROR)
        if error:
            raise DriverFault(
                f"servo {number} (model {model}): hardware error: {registers.error_text(error)}; "
                "remove the cause, then `teleop rig reset`"
            )
        moves = number in self._channels.motors
        self._put(number, registers.TORQUE_ENABLE, 0)  # before the watchdog lets an old goal go on
        self._put(number, registers.BUS_WATCHDOG, 0)  # clears one that has triggered
        self._put(number, registers.RETURN_DELAY, 0)
        for k, address in enumerate(registers.indirect_addresses()):
            entry = Register("Indirect Address", registers.INDIRECT_ADDRESS + 2 * k, 2)
            self._put(number, entry, address)
        if not moves:
            return
        self._put(number, registers.OPERATING_MODE, registers.EXTENDED_POSITION)
        if self._config.current_limit is not None:
            limit = round(self._config.current_limit / registers.CURRENT_UNIT)
            self._put(number, registers.CURRENT_LIMIT, limit)
        velocity = max(1, round(self._config.velocity_max / registers.VELOCITY_UNIT))
        self._put(number, registers.PROFILE_VELOCITY, velocity)

    def _ping(self, number: int) -> tuple[int, str]:
        """Return the model of a servo, and why there is none."""
        model, text = 0, ""
        for _ in range(TRIES):
            model, result, _ = self._packets.ping(self._port, number)
            text = result_text(result)
            if not text:
                break
        return model, text

    def _exchange(self, target: Counts | None) -> Sequence[Reading]:
        self._cycles += 1
        if target is not None and self._enabled:
            self._send(registers.GOAL_POSITION, _whole(target))
        sent_s = time.monotonic()
        result = self._read.txRxPacket()
        now = time.monotonic()
        if text := result_text(result):
            self._lost += 1
            if now - self._heard_s > self._config.timeout:
                silent = (now - self._heard_s) * 1e3
                raise DriverFault(f"{self._config.port}: {text} for {silent:.0f} ms")
            return ()
        self._heard_s = now
        status = registers.parse_status(b"".join(bytes(self._read.data_dict[k]) for k in self._ids))
        self._check(status)
        motors = status[self._motor_rows]
        self._positions = motors["position"].tolist()
        if target is None:
            self._disable(motors)
        elif not self._enabled:
            self._enable(motors, now)
        current = status["current"][self._cell_rows] * registers.CURRENT_UNIT
        # servos answer one after the other; their values are of about the middle
        sampled_s, positions = 0.5 * (sent_s + now), motors["position"].astype(float)
        return (Reading(sampled_s, positions, current, self._enabled),)

    def _check(self, status: Status) -> None:
        """Raise `DriverFault` for what a servo reports."""
        for number, one in zip(self._ids, status, strict=True):
            if text := registers.status_fault(one, self._config):
                raise DriverFault(f"servo {number}: {text}")
            if not self._enabled or number not in self._channels.motors:
                continue
            if one["watchdog"] == registers.WATCHDOG_TRIGGERED:
                raise DriverFault(
                    f"servo {number}: its bus watchdog stopped it: no instruction for "
                    f"{self._config.watchdog * 1e3:g} ms"
                )
            if not one["torque"] or one["watchdog"] != self._watchdog:
                raise DriverFault(f"servo {number}: it was restarted or disabled by itself")

    def _enable(self, motors: Status, now: float) -> None:
        """Take the next step to enabled motors; each is seen to be done before the next one.

        Goals to where the motors are, watchdog on, torque on: a servo never has torque that its
        watchdog would not stop.
        """
        self._wanted_s = min(self._wanted_s, now)
        if now - self._wanted_s > ENABLE_S:
            raise DriverFault(f"{self._config.port}: the servos do not enable their torque")
        off = motors["torque"] == 0
        strayed = np.abs(motors["goal"].astype(float) - motors["position"]) > NEAR
        if np.any(motors["watchdog"] == registers.WATCHDOG_TRIGGERED):
            self._send(registers.BUS_WATCHDOG, [0] * len(motors))
        elif np.any(off & strayed):
            self._send(registers.GOAL_POSITION, motors["position"].tolist())
        elif np.any(motors["watchdog"] != self._watchdog):
            self._send(registers.BUS_WATCHDOG, [self._watchdog] * len(motors))
        elif np.any(off):
            self._send(registers.TORQUE_ENABLE, [1] * len(motors))
        else:
            self._enabled, self._wanted_s = True, math.inf

    def _disable(self, motors: Status) -> None:
        """Switch torque off, again until the servos confirm it."""
        self._enabled, self._wanted_s = False, math.inf
        if np.any(motors["torque"]):
            self._send(registers.TORQUE_ENABLE, [0] * len(motors))

    def _send(self, register: Register, values: Sequence[int]) -> None:
        """Write a register of every motor by one packet, which nobody answers."""
        group = GroupSyncWrite(self._port, self._packets, register.address, register.size)
        for number, value in zip(self._channels.motors, values, strict=True):
            group.addParam(number, _bytes(register, value))
        if self._channels.motors:
            group.txPacket()

    def _get(self, number: int, register: Register) -> int:
        text = ""
        for _ in range(TRIES):
            data, result, _ = self._packets.readTxRx(
                self._port, number, register.address, register.size
            )
            text = result_text(result)
            if not text:
                return int.from_bytes(bytes(data), "little")
        raise DriverFault(f"servo {number}: {register.name}: {text}")

    def _put(self, number: int, register: Register, value: int) -> None:
        """Write a register and read it back; `DriverFault` if the servo does not take the value."""
        text = ""
        data = _bytes(register, value)
        for _ in range(TRIES):
            result, error = self._packets.writeTxRx(
                self._port, number, register.address, register.size, data
            )
            text = result_text(result)
            if not text and error & 0x7F:
                text = f"refused: {self._packets.getRxPacketError(error & 0x7F)}"
            if not text and self._get(number, register) != int.from_bytes(data, "little"):
                text = f"reads back other than {value}"
            if not text:
                return
        raise DriverFault(f"servo {number}: {register.name}: {text}")


def _bytes(register: Register, value: int) -> bytes:
    return (value % (1 << (8 * register.size))).to_bytes(register.size, "little")


def _whole(target: Counts) -> list[int]:
    return [max(-LIMIT, min(LIMIT, round(value))) for value in target.tolist()]
