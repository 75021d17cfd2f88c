"""Dynamixel servos that are only read: every instruction is a ping or a read."""

import time
from collections.abc import Sequence

import numpy as np
from dynamixel_sdk import GroupSyncRead

from slave.drivers.driver import Channels, Counts, DriverFault, Reading
from slave.drivers.dynamixel import registers
from slave.drivers.dynamixel.bus import ServoBus
from slave.drivers.dynamixel.config import DynamixelConfig
from slave.drivers.dynamixel.port import format_result

_SAMPLE = np.dtype(
    {
        "names": ["current", "position"],
        "formats": ["<i2", "<i4"],
        "offsets": [0, registers.PRESENT_POSITION.address - registers.PRESENT_CURRENT.address],
    }
)


class DynamixelReader:
    """A `slave.drivers.driver.BusDriver` that writes nothing and takes no targets."""

    def __init__(self, config: DynamixelConfig, channels: Channels) -> None:
        self._config, self._channels = config, channels
        self._ids = sorted({*channels.motors, *channels.cells})
        self.period_s = 1.0 / config.rate_hz
        self._bus = bus = ServoBus(config.port, config.wait)
        first = registers.PRESENT_CURRENT.address
        self._read = GroupSyncRead(bus.port, bus.packets, first, _SAMPLE.itemsize)
        for number in self._ids:
            self._read.addParam(number)
        self._motor_rows = [self._ids.index(number) for number in channels.motors]
        self._cell_rows = [self._ids.index(number) for number in channels.cells]
        self._settings: list[str] = []
        self._lost = 0
        self._heard_s = 0.0

    def start(self) -> None:
        """Open the port; look at the settings of every servo."""
        self._bus.open(self._config.baud)
        self._bus.call(self._look)
        self._heard_s = time.monotonic()

    def cycle(self, target: Counts | None) -> Sequence[Reading]:  # noqa: ARG002 - of a Driver
        """Read position and current of every servo."""
        sent_s = time.monotonic()
        text = format_result(self._bus.call(self._read.txRxPacket))
        now = time.monotonic()
        if text:
            self._lost += 1
            silent_s = now - self._heard_s
            if silent_s > self._config.timeout:
                raise DriverFault(f"{self._config.port}: {text} for {silent_s * 1e3:.0f} ms")
            return ()
        self._heard_s = now
        data = b"".join(bytes(self._read.data_dict[number]) for number in self._ids)
        samples = np.frombuffer(data, _SAMPLE)
        position = samples["position"][self._motor_rows].astype(float)
        current = samples["current"][self._cell_rows] * registers.CURRENT_UNIT
        return (Reading(0.5 * (sent_s + now), position, current),)

    def stop(self) -> None:
        """Do nothing: no motor was enabled."""

    def counts(self) -> dict[str, int | float | str]:
        """Return the reads without an answer, and the settings that a session would change."""
        counts: dict[str, int | float | str] = {"lost_reads": self._lost}
        return counts | ({"settings": "; ".join(self._settings)} if self._settings else {})

    def close(self) -> None:
        """Release the port."""
        self._bus.close()

    def _look(self) -> None:
        for number in self._ids:
            model = self._bus.ping(number)
            self._require_readable(number)
            self._bus.require_healthy(number, model)
            if number in self._channels.motors:
                limits_current = self._config.current_limit is not None
                self._bus.require_counts(number)
                if limits_current:
                    self._bus.require_current_unit(number, model)
                self._settings += [
                    f"servo {number}: {register.name} is {found}, a session sets {value}"
                    for register, found, value in self._bus.other_settings(number, limits_current)
                ]

    def _require_readable(self, number: int) -> None:
        name = registers.STATUS_RETURN.name
        try:
            self._bus.get(number, registers.STATUS_RETURN)
        except DriverFault as error:
            raise DriverFault(
                f"servo {number} answers a ping, but no reading: its {name} is 0? A session sets it"
            ) from error
