"""What `teleop rig` does with Dynamixel servos."""

import time

import serial
from dynamixel_sdk import PacketHandler

from slave.drivers.driver import DriverFault
from slave.drivers.dynamixel import registers
from slave.drivers.dynamixel.config import DynamixelConfig
from slave.drivers.dynamixel.port import WaitingPort, result_text

HIGHEST = 252  # id of a servo
PING_S = 0.003  # [s] to wait for the answer to a ping
REBOOT_S = 0.5  # [s]


def scan(config: DynamixelConfig) -> list[str]:
    """Ping every id at each baud rate; return a line for each servo."""
    lines = []
    packets = PacketHandler(2.0)
    for baud in sorted({config.baud, *registers.BAUD_CODES}):
        port = _opened(config, baud, PING_S)
        try:
            for number in range(HIGHEST + 1):
                model, result, error = packets.ping(port, number)
                if result_text(result):
                    continue
                other = "" if baud == config.baud else f"; the config says {config.baud}"
                alert = "; reports a hardware error" * bool(error & 0x80)
                lines.append(f"servo {number}: model {model} at {baud} baud{other}{alert}")
        finally:
            port.closePort()
    return lines


def reset(config: DynamixelConfig, motors: tuple[int, ...]) -> list[str]:
    """Reboot the servos, which clears their hardware errors; torque is off after it."""
    lines = []
    packets = PacketHandler(2.0)
    port = _opened(config, config.baud, config.wait)
    try:
        for number in motors:
            result, _ = packets.reboot(port, number)
            lines.append(f"servo {number}: {result_text(result) or 'restarted'}")
        time.sleep(REBOOT_S)
    finally:
        port.closePort()
    return lines


def _opened(config: DynamixelConfig, baud: int, wait_s: float) -> WaitingPort:
    port = WaitingPort(config.port, wait_s)
    port.baudrate = baud
    try:
        port.openPort()
    except (serial.SerialException, OSError) as error:
        raise DriverFault(f"{config.port}: cannot be opened: {error}") from error
    return port
