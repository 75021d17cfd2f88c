"""What `teleop rig` does with Dynamixel servos."""

import time
from collections.abc import Iterator
from functools import partial

from dynamixel_sdk.robotis_def import COMM_RX_CORRUPT

from slave.drivers.driver import DriverFault
from slave.drivers.dynamixel import registers
from slave.drivers.dynamixel.bus import ServoBus
from slave.drivers.dynamixel.config import DynamixelConfig
from slave.drivers.dynamixel.port import format_result

SERVO_ID_MAX = 252  # id of a servo
ANSWER_S = 0.03  # [s] to wait for an answer; FTDI adapters hand bytes over every 16 ms by default
REBOOT_S = 0.5  # [s]


def scan(config: DynamixelConfig) -> Iterator[str]:
    """Ask all servos to answer, at each baud rate; yield a line for each that does."""
    bus = ServoBus(config.port, ANSWER_S)
    others = [baud for baud in registers.BAUD_RATES if baud != config.baud]
    for baud in (config.baud, *others):
        try:
            bus.open(baud)
        except DriverFault:
            if baud == config.baud:
                raise
            continue  # adapters do not have every rate
        try:
            yield from bus.call(partial(_scan_baud_rate, bus, config))
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
    other = "" if baud == config.baud else f"; the config says {config.baud}"
    if slow := bus.slow_adapter():
        other += f"; {slow}"
    models, result = bus.packets.broadcastPing(bus.port)
    lines = []
    for number in sorted(models):
        model, _, error = bus.packets.ping(bus.port, number)
        alert = "; reports a hardware error" * bool(error & 0x80)
        lines.append(f"servo {number}: model {model} at {baud} baud{other}{alert}")
    if result == COMM_RX_CORRUPT:
        lines += [
            f"servo {number}: damaged answers at {baud} baud: two servos of one id?"
            for number in range(SERVO_ID_MAX + 1)
            if bus.packets.ping(bus.port, number)[1] == COMM_RX_CORRUPT
        ]
    return lines
