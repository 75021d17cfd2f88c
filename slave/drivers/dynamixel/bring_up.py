"""What `teleop rig` does with Dynamixel servos: read, scan, reset."""

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np
from dynamixel_sdk import GroupSyncRead, PacketHandler
from dynamixel_sdk.robotis_def import COMM_RX_CORRUPT, COMM_SUCCESS

from slave.drivers.driver import BusReading, Channels, Counts, DriverFault
from slave.drivers.dynamixel import registers, servo_check
from slave.drivers.dynamixel.bus import TWINS_TEXT, ServoBus, format_result
from slave.drivers.dynamixel.config import DynamixelConfig
from slave.drivers.ports import find_slow_timer

# --- servos that are only read: every instruction is a ping or a read

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
        self._cell_units: dict[int, float] = {}  # [A] a count
        self._lost = 0
        self._heard_s = 0.0

    def start(self) -> None:
        """Open the port; look at the settings of every servo."""
        self._bus.open(self._config.baud)
        self._bus.call(self._look)
        self._heard_s = time.monotonic()

    def run_cycle(self, target: Counts | None) -> Sequence[BusReading]:  # noqa: ARG002 - of a Driver
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
        units = [self._cell_units[number] for number in self._channels.cells]
        current = samples["current"][self._cell_rows] * units
        return (BusReading(0.5 * (sent_s + now), position, current),)

    def stop(self) -> None:
        """Do nothing: no motor was enabled."""

    def summarise(self) -> dict[str, int | float | str]:
        """Return the reads without an answer, and the settings that a session would change."""
        return {"lost_reads": self._lost, **self._bus.describe(self._settings)}

    def close(self) -> None:
        """Release the port."""
        self._bus.close()

    def _look(self) -> None:
        for number in self._ids:
            model = self._bus.ping(number)
            servo_check.require_known_table(number, model)
            if number in self._channels.cells:
                self._cell_units[number] = servo_check.require_current_unit(
                    number, model, servo_check.AS_CELL
                )
            self._require_readable(number)
            servo_check.require_healthy(self._bus, number, model)
            if number in self._channels.motors:
                limits_current = self._config.current_limit is not None
                servo_check.require_counts(self._bus, number)
                if limits_current:
                    servo_check.require_current_unit(number, model, servo_check.AS_LIMIT)
                others = servo_check.find_other_settings(self._bus, number, limits_current)
                self._settings += [
                    f"servo {number}: {register.name} is {actual}, a session sets {value}"
                    for register, actual, value in others
                ]

    def _require_readable(self, number: int) -> None:
        name = registers.STATUS_RETURN.name
        try:
            self._bus.get(number, registers.STATUS_RETURN)
        except DriverFault as error:
            raise DriverFault(
                f"servo {number} answers a ping, but no reading: its {name} is 0? A session sets it"
            ) from error


SERVO_ID_MAX = 252  # id of a servo
ANSWER_S = 0.03  # [s] to wait for an answer; FTDI adapters hand bytes over every 16 ms by default
REBOOT_S = 0.5  # [s]
OLD_RATES, OLD_ID_MAX = (57600, 1_000_000), 20  # asked in protocol 1.0, which has no broadcast ping


def scan(config: DynamixelConfig) -> Iterator[str]:
    """Ask all servos to answer, at each baud rate; yield a line for each that does.

    If none does, those of protocol 1.0 are looked for.
    """
    bus, found = ServoBus(config.port, ANSWER_S), False
    rates = dict.fromkeys((config.baud, *registers.BAUD_RATES))
    scan_baud_rate = partial(_scan_baud_rate, config=config)
    looks: list[tuple[int, Callable[[ServoBus], list[str]]]]
    looks = [(baud, scan_baud_rate) for baud in rates]
    looks += [(baud, _scan_old_protocol) for baud in rates if baud in (config.baud, *OLD_RATES)]
    for baud, look in looks:
        if found and look is _scan_old_protocol:
            return
        try:
            bus.open(baud)
        except DriverFault:
            if baud == config.baud:
                raise
            continue  # adapters do not have every rate
        try:
            for line in bus.call(partial(look, bus)):
                found = True
                yield line
        finally:
            bus.close()


def reset(config: DynamixelConfig, motors: tuple[int, ...]) -> Iterator[str]:
    """Reboot the servos, which clears their hardware errors; torque is off after it."""
    failed = []
    bus = ServoBus(config.port, ANSWER_S)
    bus.open(config.baud)
    try:
        for number in motors:
            result, _ = bus.call(partial(bus.packets.reboot, bus.port, number))
            if text := format_result(result):
                failed.append(f"servo {number}: {text}")
            else:
                yield f"servo {number}: restarted"
        time.sleep(REBOOT_S)
    finally:
        bus.close()
    if failed:
        raise DriverFault(f"{config.port}: not reset: {', '.join(failed)}")


def _scan_baud_rate(bus: ServoBus, config: DynamixelConfig) -> list[str]:
    """Return a line for each servo at the present baud rate, and one for damaged answers."""
    baud = bus.port.baudrate
    hint = "" if baud == config.baud else f"; the config says {config.baud}"
    if warning := find_slow_timer(bus.path):
        hint += f"; {warning}"
    models, result = bus.packets.broadcastPing(bus.port)
    lines = []
    for number in sorted(models):
        model, _, error = bus.packets.ping(bus.port, number)
        alert = "; reports a hardware error" * bool(error & 0x80)
        alert += "; not of the X series: no driver" * (not registers.has_known_table(model))
        lines.append(f"servo {number}: model {model} at {baud} baud{hint}{alert}")
    if result == COMM_RX_CORRUPT:
        lines += [
            f"servo {number}: damaged answers at {baud} baud: {TWINS_TEXT}"
            for number in range(SERVO_ID_MAX + 1)
            if bus.packets.ping(bus.port, number)[1] == COMM_RX_CORRUPT
        ]
    return lines


def _scan_old_protocol(bus: ServoBus) -> list[str]:
    """Return a line for each servo that speaks protocol 1.0 at the present baud rate."""
    packets = PacketHandler(1.0)
    return [
        f"servo {number}: speaks protocol 1.0 at {bus.port.baudrate} baud: set its Protocol Type "
        "to 2 by the Dynamixel Wizard (an MX: its firmware 2.0); AX and Feetech have no driver"
        for number in range(OLD_ID_MAX + 1)
        if packets.ping(bus.port, number)[1] == COMM_SUCCESS
    ]
