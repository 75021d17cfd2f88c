"""The driver of Dynamixel servos: one sync read and one sync write a cycle, by the vendor's SDK."""

import contextlib
import math
import termios
import time
from collections import ChainMap
from collections.abc import Sequence

import numpy as np
import serial
from dynamixel_sdk import GroupSyncRead, GroupSyncWrite

from slave.drivers.driver import BusReading, Channels, Counts, DriverFault
from slave.drivers.dynamixel import registers, servo_check
from slave.drivers.dynamixel.bus import ServoBus, format_result
from slave.drivers.dynamixel.config import WATCHDOG_UNIT, DynamixelConfig
from slave.drivers.dynamixel.registers import STATUS_SIZE, Register, Status

GOAL_ERROR_MAX = 20  # [counts] of a goal from the position, when torque is switched on
ENABLE_S = 0.5  # [s] in which torque must be on
LIMIT = (1 << 31) - 1  # [counts]


class DynamixelDriver:
    """A `BusDriver`; a cell's reading is the present current of that servo [A].

    The goal is set to the present position before torque is enabled. Each servo's bus watchdog
    stops it when instructions cease; then it refuses goals, and this is a fault.
    """

    def __init__(self, config: DynamixelConfig, channels: Channels) -> None:
        self._config, self._channels = config, channels
        self._ids = sorted({*channels.motors, *channels.cells})
        self.period_s = 1.0 / config.rate_hz
        self._bus = ServoBus(config.port, config.wait)
        self._reads: dict[int, GroupSyncRead] = {}  # by address, of servos of unlike models
        self._motor_rows = [self._ids.index(number) for number in channels.motors]
        self._cell_rows = [self._ids.index(number) for number in channels.cells]
        self._cell_units: dict[int, float] = {}  # [A] a count
        self._watchdog = round(config.watchdog / WATCHDOG_UNIT)
        self._enabled = False
        self._positions: list[int] = []  # of the motors, read last
        self._wanted_s = math.inf
        self._cycles = self._lost = 0
        self._began_s = self._heard_s = 0.0
        self._changed: list[str] = []  # settings of other programs

    def start(self) -> None:
        """Open the port; set up every servo and check it. Torque is off afterwards."""
        self._bus.open(self._config.baud)
        self._bus.call(self._set_up_all)
        self._began_s = self._heard_s = time.monotonic()

    def run_cycle(self, target: Counts | None) -> Sequence[BusReading]:
        """Send the goals, read position, current and status of every servo."""
        return self._bus.call(lambda: self._exchange(target))

    def stop(self) -> None:
        """Torque off; `run_cycle` repeats it until every servo confirms it."""
        self._enabled = False
        torque_off = [0] * len(self._channels.motors)
        self._bus.call(lambda: self._send(registers.TORQUE_ENABLE, torque_off))

    def summarise(self) -> dict[str, int | float | str]:
        """Return rate, reads without an answer of every servo, and settings that were changed."""
        span = self._heard_s - self._began_s
        answered = self._cycles - self._lost
        return {
            "rate_hz": round(answered / span, 1) if span > 0.0 else 0.0,
            "lost_reads": self._lost,
            **self._bus.describe(self._changed),
        }

    def close(self) -> None:
        """Stop the servos where they are, by their goals and then their watchdogs; torque holds."""
        if not self._bus.is_open:
            return
        with contextlib.suppress(serial.SerialException, termios.error, OSError):
            if self._enabled or self._wanted_s < math.inf:  # or about to be
                self._send(registers.GOAL_POSITION, self._positions)
                self._send(registers.BUS_WATCHDOG, [1] * len(self._positions))
        self._bus.close()

    def _set_up_all(self) -> None:
        for number in self._ids:
            self._set_up(number)
            address = servo_check.find_status_address(self._bus, number)
            if address not in self._reads:
                self._reads[address] = GroupSyncRead(
                    self._bus.port, self._bus.packets, address, STATUS_SIZE
                )
            self._reads[address].addParam(number)

    def _set_up(self, number: int) -> None:
        """Set up one servo, torque off: the order matters, its EEPROM is locked with torque on."""
        bus = self._bus
        model = bus.ping(number)
        servo_check.require_known_table(number, model)
        if number in self._channels.cells:
            self._cell_units[number] = servo_check.require_current_unit(
                number, model, servo_check.AS_CELL
            )
        bus.put_unconfirmed(number, registers.STATUS_RETURN, registers.ANSWERS_ALL)
        servo_check.require_healthy(bus, number, model)
        moves = number in self._channels.motors
        limit, unit = self._config.current_limit, 0.0
        if moves:
            servo_check.require_counts(bus, number)
            if limit is not None:
                unit = servo_check.require_current_unit(number, model, servo_check.AS_LIMIT)
        bus.put(number, registers.TORQUE_ENABLE, 0)  # before the watchdog lets an old goal go on
        bus.put(number, registers.BUS_WATCHDOG, 0)  # clears one that has triggered
        bus.put(number, registers.RETURN_DELAY, 0)
        bus.put(number, registers.INDIRECT_ADDRESSES, registers.pack_indirect_addresses())
        if not moves:
            return
        for register, actual, value in servo_check.find_other_settings(
            bus, number, limit is not None
        ):
            bus.put(number, register, value)
            self._changed.append(f"servo {number}: {register.name} was {actual}, set to {value}")
        if limit is not None:  # after the operating mode, whose change resets the goal current
            counts = registers.to_current_counts(limit, unit)
            bus.put(number, registers.CURRENT_LIMIT, counts)
            bus.put(number, registers.GOAL_CURRENT, counts)
        bus.put(number, registers.GOAL_PWM, bus.get(number, registers.PWM_LIMIT))
        velocity = max(1, round(self._config.velocity_max / registers.VELOCITY_UNIT))
        bus.put(number, registers.PROFILE_VELOCITY, velocity)

    def _exchange(self, target: Counts | None) -> Sequence[BusReading]:
        self._cycles += 1
        if target is not None and self._enabled:
            goals = [max(-LIMIT, min(LIMIT, round(value))) for value in target.tolist()]
            self._send(registers.GOAL_POSITION, goals)
        sent_s = time.monotonic()
        results = [read.txRxPacket() for read in self._reads.values()]
        now = time.monotonic()
        if text := next(filter(None, map(format_result, results)), ""):
            self._lost += 1
            if now - self._heard_s > self._config.timeout:
                silent = (now - self._heard_s) * 1e3
                raise DriverFault(f"{self._config.port}: {text} for {silent:.0f} ms")
            return ()
        self._heard_s = now
        data = ChainMap(*(read.data_dict for read in self._reads.values()))
        status = registers.parse_status(b"".join(bytes(data[k]) for k in self._ids))
        self._check(status)
        motors = status[self._motor_rows]
        self._positions = motors["position"].tolist()
        if target is None:
            self._disable(motors)
        elif not self._enabled:
            self._enable(motors, now)
        units = [self._cell_units[number] for number in self._channels.cells]
        current = status["current"][self._cell_rows] * units
        # servos answer one after the other; their values are of about the middle
        sampled_s, positions = 0.5 * (sent_s + now), motors["position"].astype(float)
        return (BusReading(sampled_s, positions, current, self._enabled),)

    def _check(self, status: Status) -> None:
        """Raise `DriverFault` for what a servo reports."""
        for number, row in zip(self._ids, status, strict=True):
            if text := registers.find_status_fault(row, self._config):
                raise DriverFault(f"servo {number}: {text}")
            if not self._enabled or number not in self._channels.motors:
                continue
            if row["watchdog"] == registers.WATCHDOG_TRIGGERED:
                raise DriverFault(
                    f"servo {number}: its bus watchdog stopped it: no instruction for "
                    f"{self._config.watchdog * 1e3:g} ms"
                )
            if not row["torque"] or row["watchdog"] != self._watchdog:
                raise DriverFault(f"servo {number}: it was restarted or disabled by itself")

    def _enable(self, motors: Status, now: float) -> None:
        """Take the next step to enabled motors; each is seen to be done before the next one.

        Goals to where the motors are, watchdog on, torque on: a servo never has torque that its
        watchdog would not stop.
        """
        self._wanted_s = min(self._wanted_s, now)
        if now - self._wanted_s > ENABLE_S:
            raise DriverFault(f"{self._config.port}: the servos do not enable their torque")
        is_off = motors["torque"] == 0
        strayed = np.abs(motors["goal"].astype(float) - motors["position"]) > GOAL_ERROR_MAX
        if np.any(motors["watchdog"] == registers.WATCHDOG_TRIGGERED):
            self._send(registers.BUS_WATCHDOG, [0] * len(motors))
        elif np.any(is_off & strayed):
            self._send(registers.GOAL_POSITION, motors["position"].tolist())
        elif np.any(motors["watchdog"] != self._watchdog):
            self._send(registers.BUS_WATCHDOG, [self._watchdog] * len(motors))
        elif np.any(is_off):
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
        group = GroupSyncWrite(self._bus.port, self._bus.packets, register.address, register.size)
        for number, value in zip(self._channels.motors, values, strict=True):
            group.addParam(number, register.pack(value))
        if self._channels.motors:
            group.txPacket()
