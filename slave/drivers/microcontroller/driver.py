"""The driver of a microcontroller: takes its states as they come, answers each with the targets."""

import math
import socket
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress

import numpy as np
import serial

from slave.drivers.driver import BusReading, Channels, Counts, DriverFault
from slave.drivers.microcontroller import frames
from slave.drivers.microcontroller.config import MicrocontrollerConfig
from slave.drivers.microcontroller.frames import (
    BoardFlags,
    BoardInfo,
    BoardState,
    Frame,
    FrameReader,
    FrameType,
)
from slave.drivers.serial_port import format_port_error, open_serial

# --- times of a device's own clock on the machine's clock

DRIFT = 200e-6  # largest relative error of the device's crystal
WRAP = 1 << 32  # [us] of the device's clock


class ClockMap:
    """Maps a device's clock of microseconds, 32 bits wide, to the machine's monotonic clock [s].

    A frame arrives at `sampled + offset + delay` with a delay of at least zero, so the least
    difference of arrival and device time is the best estimate of the offset. It may grow by `DRIFT`
    since crystals differ.
    """

    def __init__(self) -> None:
        self._offset_s: float | None = None
        self._unwrapped_us = 0

    def __call__(self, device_us: int, arrival_s: float) -> float:
        """Return the time [s] at which a frame with this device time was sampled."""
        if self._offset_s is None:
            self._unwrapped_us = device_us
            self._offset_s = arrival_s - device_us * 1e-6
            return arrival_s
        elapsed_us = (device_us - self._unwrapped_us) % WRAP
        self._unwrapped_us += elapsed_us
        device_s = self._unwrapped_us * 1e-6
        grown = self._offset_s + elapsed_us * 1e-6 * DRIFT
        self._offset_s = min(grown, arrival_s - device_s)
        return device_s + self._offset_s


HELLO_S = 0.2  # [s] between two greetings; a board that was just opened may reset itself
GREETING_S = 6.0  # [s] within which it must answer
WAIT_S = 0.010  # [s] of one cycle without a state
ERROR_WINDOW_S = 1.0  # [s] over which errors are counted
ENABLE_S = 0.5  # [s] in which the motors must be enabled
LIMIT = (1 << 31) - 1  # [counts]
_SILENT_TEXT = "is the firmware of firmware/ on the board, and the baud rate right?"


class MicrocontrollerDriver:
    """A `BusDriver`; the board samples on its own clock and sends every sample.

    The board enables its motors at the first target. Once it has stopped them by itself (watchdog,
    emergency stop), they stay off until a SET that disables them was answered.
    """

    period_s = 0.0

    def __init__(self, config: MicrocontrollerConfig, channels: Channels) -> None:
        self._config, self._channels = config, channels
        self._reader = FrameReader()
        self._clock = ClockMap()
        self._port: serial.Serial | None = None
        self._claim: socket.socket | None = None
        self.info: BoardInfo | None = None  # what the board said it is, once started
        self._sequence = self._states = 0
        self._heard_s = self._wanted_s = math.inf
        self._errors: deque[tuple[float, int]] = deque([(0.0, 0)])
        self._enable = False  # whether the motors are told to follow
        self._obeyed = False  # whether they do
        self._began_s = 0.0

    def start(self) -> None:
        """Open the port, greet the board, check what it has; its motors are disabled."""
        config = self._config
        self._port, self._claim = open_serial(
            config.port, config.baud, timeout=WAIT_S, write_timeout=0.1
        )
        self.info = info = self._greet()
        for name, expected, count in (
            ("motor", self._channels.motors, info.motors),
            ("cell", self._channels.cells, info.cells),
        ):
            for number in expected:
                if not 1 <= number <= count:
                    raise DriverFault(
                        f"{config.port}: the board has {count} {name}s, there is no {name} {number}"
                    )
        if self._channels.motors and info.watchdog_ms != round(config.watchdog * 1e3):
            raise DriverFault(
                f"{config.port}: the board's watchdog is {info.watchdog_ms} ms, "
                f"{config.watchdog * 1e3:g} ms was asked for"
            )
        self._began_s = self._heard_s = time.monotonic()
        self._send_targets(None)

    def run_cycle(self, target: Counts | None) -> Sequence[BusReading]:
        """Take the states that have come, and answer them."""
        readings = []
        arrived = self._receive()
        now = time.monotonic()
        for frame in arrived:
            if frame.kind != FrameType.STATE:
                continue
            state = self._parse(frame)
            self._states += 1
            self._heard_s = now
            self._check(state, now)
            position = _select_channels(state.position, self._channels.motors)
            cell = _select_channels(state.cell, self._channels.cells)
            readings.append(
                BusReading(self._clock(frame.time_us, now), position, cell, self._obeyed)
            )
        if now - self._heard_s > self._config.timeout:
            raise DriverFault(
                f"{self._config.port}: silent for {(now - self._heard_s) * 1e3:.0f} ms"
            )
        self._check_errors(now)
        if readings:
            self._send_targets(target)
        return readings

    def stop(self) -> None:
        """Let the board switch its motors off."""
        self._enable = self._obeyed = False
        self._send(FrameType.STOP)

    def summarise(self) -> dict[str, int | float | str]:
        """Return frames, damaged and lost frames, and the rate."""
        span = self._heard_s - self._began_s if self._states else 0.0
        return {
            "rate_hz": round(self._states / span, 1) if span > 0.0 else 0.0,
            "bad_frames": self._reader.bad,
            "lost_frames": self._reader.lost,
        }

    def close(self) -> None:
        """Switch the motors off."""
        if self._port is None or self._claim is None:
            return
        with suppress(DriverFault, serial.SerialException, OSError):  # it is unplugged: its
            if self._channels.motors:  # watchdog stops the motors
                self._send(FrameType.STOP)
            self._port.close()
        self._claim.close()
        self._port = None

    def _greet(self) -> BoardInfo:
        until_s, due_s = time.monotonic() + GREETING_S, 0.0
        while (now := time.monotonic()) < until_s:
            if now >= due_s:
                due_s = now + HELLO_S
                self._send(FrameType.HELLO, frames.pack_hello(self._config.watchdog))
            for frame in self._receive():
                if frame.kind == FrameType.INFO:
                    self._reader.bad = self._reader.lost = 0  # the rest of a frame cut at opening
                    return frames.parse_info(frame.body)
        damaged = f", {self._reader.bad} damaged frames" if self._reader.bad else ""
        raise DriverFault(
            f"{self._config.port}: no answer within {GREETING_S:g} s{damaged}: {_SILENT_TEXT}"
        )

    def _receive(self) -> list[Frame]:
        if self._port is None:
            return []
        try:
            data = self._port.read(self._port.in_waiting or 1)
        except (serial.SerialException, OSError) as error:
            raise DriverFault(
                f"{self._config.port}: unplugged ({format_port_error(error, self._config.port)})"
            ) from error
        return self._reader.feed(data)

    def _parse(self, frame: Frame) -> BoardState:
        try:
            return frames.parse_state(frame.body)
        except frames.FrameError as error:
            raise DriverFault(f"{self._config.port}: {error}") from error

    def _check(self, state: BoardState, now: float) -> None:
        """Raise `DriverFault` for what the board reports."""
        port = self._config.port
        if self._channels.motors and state.flags & BoardFlags.MOTOR_FAULT:
            raise DriverFault(f"{port}: the board reports a fault of its motors")
        if self._channels.cells and state.flags & BoardFlags.CELL_FAULT:
            raise DriverFault(f"{port}: the board's converter of the load cells does not answer")
        if not self._enable:
            return
        if state.flags & BoardFlags.ENABLED:
            self._obeyed = True
        elif self._obeyed and state.flags & BoardFlags.WATCHDOG:
            raise DriverFault(
                f"{port}: the board stopped the motors: no target for "
                f"{self._config.watchdog * 1e3:g} ms"
            )
        elif self._obeyed:
            restarted = ": it has restarted" if state.flags & BoardFlags.STOPPED else ""
            raise DriverFault(f"{port}: the board stopped the motors by itself{restarted}")
        elif now - self._wanted_s > ENABLE_S:
            raise DriverFault(f"{port}: the board does not enable its motors")

    def _check_errors(self, now: float) -> None:
        total = self._reader.bad + self._reader.lost
        if total != self._errors[-1][1]:
            self._errors.append((now, total))
        while len(self._errors) > 1 and self._errors[1][0] < now - ERROR_WINDOW_S:
            self._errors.popleft()
        count = total - self._errors[0][1]
        if count > self._config.errors_max:
            raise DriverFault(
                f"{self._config.port}: {count} damaged or lost frames within a second: "
                "check cable, shield and baud rate"
            )

    def _send_targets(self, target: Counts | None) -> None:
        count = self.info.motors if self.info else 0
        if not self._channels.motors:
            return
        values = [frames.MISSING] * count
        if target is not None:
            for number, value in zip(self._channels.motors, target.tolist(), strict=True):
                values[number - 1] = max(-LIMIT, min(LIMIT, round(value)))
        enable = target is not None
        if enable and not self._enable:
            self._wanted_s = time.monotonic()
        self._enable = enable
        self._obeyed = self._obeyed and enable
        self._send(FrameType.SET, frames.pack_targets(tuple(values), enable))

    def _send(self, kind: FrameType, body: bytes = b"") -> None:
        if self._port is None:
            return
        self._sequence += 1
        try:
            time_us = time.monotonic_ns() // 1000
            self._port.write(frames.encode(kind, self._sequence, time_us, body))
        except (serial.SerialException, OSError) as error:
            raise DriverFault(
                f"{self._config.port}: unplugged ({format_port_error(error, self._config.port)})"
            ) from error


def _select_channels(values: tuple[int, ...], numbers: tuple[int, ...]) -> Counts:
    """Return the values of the channels in use; NaN if the board could not read one."""
    present = {k: float(v) for k, v in enumerate(values, 1) if v != frames.MISSING}
    return np.array([present.get(number, math.nan) for number in numbers])


# --- a microcontroller that is only listened to: it sends its states by itself

LISTEN_S = 6.0  # [s] within which a state must come; a board may restart as its port is opened


class MicrocontrollerReader(MicrocontrollerDriver):
    """A `MicrocontrollerDriver` that sends nothing and takes no targets."""

    def _greet(self) -> BoardInfo:
        """Wait for a state, which tells what the board has."""
        until_s = time.monotonic() + LISTEN_S
        while time.monotonic() < until_s:
            for frame in self._receive():
                if frame.kind == FrameType.STATE:
                    state = self._parse(frame)
                    self._reader.bad = self._reader.lost = 0  # a frame was cut at opening
                    watchdog_ms = round(self._config.watchdog * 1e3)
                    return BoardInfo(watchdog_ms, 0, len(state.position), len(state.cell), "")
        raise DriverFault(
            f"{self._config.port}: no states of a board within {LISTEN_S:g} s: {_SILENT_TEXT}"
        )

    def _send(self, kind: FrameType, body: bytes = b"") -> None:
        """Send nothing."""


# --- what `teleop rig` does with a microcontroller


def scan(config: MicrocontrollerConfig) -> Iterator[str]:
    """Greet the board; yield what it says it is."""
    driver = MicrocontrollerDriver(config, Channels())
    try:
        driver.start()
        info = driver.info
    finally:
        driver.close()
    if info is not None:
        board = f"{info.motors} motors, {info.cells} cells, {info.rate_hz} Hz"
        yield f"{config.port}: {info.name}, {board}"


def reset(config: MicrocontrollerConfig, motors: tuple[int, ...]) -> Iterator[str]:  # noqa: ARG001
    """Yield that there is nothing to reset from here."""
    yield f"{config.port}: its faults end with their cause; restart the board if they do not"
