"""What must hold of a Dynamixel servo before its torque is switched on.

Registers keep what other programs left there. What a driver cannot set without changing what the
config means is refused by the register's name; what it sets is listed, so that it can be said.
"""

from slave.drivers.driver import DriverFault
from slave.drivers.dynamixel import registers
from slave.drivers.dynamixel.bus import ServoBus
from slave.drivers.dynamixel.registers import Register


def require_healthy(bus: ServoBus, number: int, model: int) -> None:
    """Raise `DriverFault` if a servo has a hardware error."""
    error = bus.get(number, registers.HARDWARE_ERROR)
    if error:
        raise DriverFault(
            f"servo {number} (model {model}): hardware error: "
            f"{registers.format_hardware_error(error)}; "
            "remove the cause, then `teleop rig reset`"
        )


def require_counts(bus: ServoBus, number: int) -> None:
    """Raise `DriverFault` if the servo counts positions otherwise than the config means.

    These are not set by a driver: `zero` and `direction` in the config would silently mean
    another place.
    """
    offset = bus.get(number, registers.HOMING_OFFSET)
    if offset:
        offset -= (offset >> 31) << 32
        raise DriverFault(
            f"servo {number}: {registers.HOMING_OFFSET.name} is {offset} counts, must be 0: "
            "set it by the Dynamixel Wizard, then read `zero` anew"
        )
    if bus.get(number, registers.DRIVE_MODE) & registers.REVERSE:
        raise DriverFault(
            f"servo {number}: {registers.DRIVE_MODE.name} is reverse, must be normal: set it "
            "by the Dynamixel Wizard, then use `direction: -1` where it is needed"
        )


def require_current_unit(number: int, model: int) -> float:
    """Return the unit [A] of a servo's currents; `DriverFault` if it cannot limit them."""
    unit = registers.CURRENT_UNITS.get(model)
    if unit is None:
        raise DriverFault(
            f"servo {number}: model {model} has no current-based position mode known to this "
            "driver: set current_limit to null and limit the torque by the servo's PWM Limit"
        )
    return unit


def find_other_settings(
    bus: ServoBus, number: int, limits_current: bool
) -> list[tuple[Register, int, int]]:
    """Return the registers left by other programs that a driver sets: what is there, and to."""
    shutdown = bus.get(number, registers.SHUTDOWN) | registers.SHUTDOWN_ERRORS
    settings = (*registers.list_settings(limits_current), (registers.SHUTDOWN, shutdown))
    read = [(register, bus.get(number, register), value) for register, value in settings]
    return [entry for entry in read if entry[1] != entry[2]]
