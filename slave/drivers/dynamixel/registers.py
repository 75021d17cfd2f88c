"""Control table of the X series (ROBOTIS e-manual, XM430-W350 and relatives), and what it means."""

import math
from enum import IntFlag
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slave.drivers.dynamixel.config import DynamixelConfig

Status = NDArray[np.void]
"""Status of servos, shape (servos,) of `STATUS_DTYPE`."""


class Register(NamedTuple):
    """One entry of the control table."""

    name: str
    address: int
    size: int  # [B]

    def pack(self, value: int) -> bytes:
        """Return the bytes of a value, which may be negative."""
        return (value % (1 << (8 * self.size))).to_bytes(self.size, "little")


RETURN_DELAY = Register("Return Delay Time", 9, 1)  # [2 us]
DRIVE_MODE = Register("Drive Mode", 10, 1)
OPERATING_MODE = Register("Operating Mode", 11, 1)
SECONDARY_ID = Register("Secondary ID", 12, 1)
HOMING_OFFSET = Register("Homing Offset", 20, 4)
PWM_LIMIT = Register("PWM Limit", 36, 2)
CURRENT_LIMIT = Register("Current Limit", 38, 2)  # [2.69 mA], of current control and mode 5
STARTUP = Register("Startup Configuration", 60, 1)  # torque on, goals restored, at power on
SHUTDOWN = Register("Shutdown", 63, 1)  # errors at which torque goes off
TORQUE_ENABLE = Register("Torque Enable", 64, 1)
STATUS_RETURN = Register("Status Return Level", 68, 1)
HARDWARE_ERROR = Register("Hardware Error Status", 70, 1)
BUS_WATCHDOG = Register("Bus Watchdog", 98, 1)  # [20 ms]; 255 after it has triggered
GOAL_PWM = Register("Goal PWM", 100, 2)  # the most that any mode uses
GOAL_CURRENT = Register("Goal Current", 102, 2)  # [2.69 mA]; in mode 5 the largest current
PROFILE_ACCELERATION = Register("Profile Acceleration", 108, 4)
PROFILE_VELOCITY = Register("Profile Velocity", 112, 4)  # [0.229 rev/min]
GOAL_POSITION = Register("Goal Position", 116, 4)
PRESENT_CURRENT = Register("Present Current", 126, 2)
PRESENT_POSITION = Register("Present Position", 132, 4)
INPUT_VOLTAGE = Register("Present Input Voltage", 144, 2)  # [0.1 V]
TEMPERATURE = Register("Present Temperature", 146, 1)  # [deg C]
INDIRECT_DATA = (224, 208)  # of the first; X330 servos have fewer indirect addresses before it

EXTENDED_POSITION = 4  # operating mode: several turns, no limit of the current
CURRENT_BASED_POSITION = 5  # operating mode: several turns, the current limited
WATCHDOG_TRIGGERED = 255
CURRENT_UNIT = 2.69e-3  # [A]
VELOCITY_UNIT = 0.229 * 2.0 * math.pi / 60.0  # [rad/s]
REVERSE = 1  # bit of the drive mode; the others are time-based profile, torque on by goal update
ANSWERS_ALL = 2  # status return level
BAUD_RATES = (1_000_000, 57600, 2_000_000, 3_000_000, 4_000_000, 4_500_000, 115200, 9600)

CURRENT_UNITS = {
    **dict.fromkeys((1000, 1010), CURRENT_UNIT),  # XH430-W
    **dict.fromkeys((1001, 1011), CURRENT_UNIT),  # XD430
    **dict.fromkeys((1020, 1030), CURRENT_UNIT),  # XM430
    **dict.fromkeys((1040, 1050), 1.34e-3),  # XH430-V
    **dict.fromkeys((1100, 1110, 1140, 1150), CURRENT_UNIT),  # XH540
    **dict.fromkeys((1101, 1111), CURRENT_UNIT),  # XD540
    **dict.fromkeys((1120, 1130), CURRENT_UNIT),  # XM540
    **dict.fromkeys((1170, 1180, 1310), CURRENT_UNIT),  # XW540
    **dict.fromkeys((1270, 1280), CURRENT_UNIT),  # XW430
    **dict.fromkeys((1190, 1200), 1.0e-3),  # XL330
    **dict.fromkeys((1210, 1220, 1230, 1240), 1.0e-3),  # XC330
    1710: 1.0e-3,  # XM335
    **dict.fromkeys((311, 321), 3.36e-3),  # MX-64, MX-106 of protocol 2.0
}
"""Units of current [A] of the models with the current-based position mode (e-manual).

XL430, XC430, 2XL430 and 2XC430 measure no current.
"""

STATUS = (
    PRESENT_POSITION,
    GOAL_POSITION,
    PRESENT_CURRENT,
    HARDWARE_ERROR,
    INPUT_VOLTAGE,
    TEMPERATURE,
    TORQUE_ENABLE,
    BUS_WATCHDOG,
)
"""What one sync read brings, through the indirect addresses, in this order."""

STATUS_DTYPE = np.dtype(
    [
        ("position", "<i4"),
        ("goal", "<i4"),
        ("current", "<i2"),
        ("error", "u1"),
        ("voltage", "<u2"),
        ("temperature", "u1"),
        ("torque", "u1"),
        ("watchdog", "u1"),
    ]
)
STATUS_SIZE = STATUS_DTYPE.itemsize
INDIRECT_ADDRESSES = Register("Indirect Address", 168, 2 * STATUS_SIZE)


class HardwareError(IntFlag):
    """Bits of `HARDWARE_ERROR`."""

    INPUT_VOLTAGE = 1
    OVERHEATING = 4
    MOTOR_ENCODER = 8
    ELECTRICAL_SHOCK = 16
    OVERLOAD = 32


SHUTDOWN_ERRORS = (
    HardwareError.OVERHEATING | HardwareError.ELECTRICAL_SHOCK | HardwareError.OVERLOAD
)
"""At which a servo must switch its torque off by itself, as the maker sets it."""

ERROR_TEXT = {
    HardwareError.INPUT_VOLTAGE: "input voltage out of range",
    HardwareError.OVERHEATING: "too hot",
    HardwareError.MOTOR_ENCODER: "motor encoder fails",
    HardwareError.ELECTRICAL_SHOCK: "electrical shock or too little power",
    HardwareError.OVERLOAD: "overload",
}


def has_known_table(model: int) -> bool:
    """Return whether a model has the control table of this file: X series, MX of protocol 2.0."""
    return 1000 <= model < 2000 or model in (30, 311, 321)


def list_settings(limits_current: bool) -> tuple[tuple[Register, int], ...]:
    """Return what decides how a servo moves and answers, in the order in which it is set.

    The extended position mode does not limit the current.
    """
    return (
        (STATUS_RETURN, ANSWERS_ALL),
        (SECONDARY_ID, 255),  # none: else it follows the goals of another servo
        (DRIVE_MODE, 0),
        (STARTUP, 0),
        (OPERATING_MODE, CURRENT_BASED_POSITION if limits_current else EXTENDED_POSITION),
        (PROFILE_ACCELERATION, 0),  # none
    )


def to_current_counts(current: float, unit: float) -> int:
    """Return the largest count of `unit` [A] that is not above a current [A]; 1 at least."""
    return max(1, math.floor(current / unit + 1e-6))


def pack_indirect_addresses() -> int:
    """Return the addresses behind the bytes of `STATUS`, two bytes each, as one value."""
    addresses = [register.address + k for register in STATUS for k in range(register.size)]
    return int.from_bytes(np.array(addresses, "<u2").tobytes(), "little")


def parse_status(data: bytes) -> Status:
    """Return the status of servos from their bytes in a row."""
    return np.frombuffer(data, STATUS_DTYPE)


def format_hardware_error(bits: int) -> str:
    """Return a hardware error in words; empty if there is none."""
    return ", ".join(text for bit, text in ERROR_TEXT.items() if bits & bit) or (
        f"unknown hardware error {bits}" if bits else ""
    )


def find_status_fault(status: "np.void", config: DynamixelConfig) -> str:
    """Return what is wrong with one servo, in words; empty if nothing is."""
    if text := format_hardware_error(int(status["error"])):
        return f"hardware error: {text}; remove the cause, then `teleop rig reset`"
    volts, (volts_min, volts_max) = int(status["voltage"]) * 0.1, config.voltage
    if not volts_min <= volts <= volts_max:
        return f"supply of {volts:.1f} V, must be {volts_min:g} to {volts_max:g} V (voltage)"
    if int(status["temperature"]) > config.temperature_max:
        return f"{int(status['temperature'])} deg C, {config.temperature_max:g} at most"
    return ""
