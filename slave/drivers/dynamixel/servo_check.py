"""What must hold of a Dynamixel servo before its torque is switched on.

Registers keep what other programs left there. What a driver cannot set without changing what the
config means is refused by the register's name; what it sets is listed, so that it can be said.
"""

from contextlib import suppress

from slave.drivers.driver import DriverFault
from slave.drivers.dynamixel import registers
from slave.drivers.dynamixel.bus import ServoBus
from slave.drivers.dynamixel.registers import Register

VOLTS_MARGIN = 10  # [0.1 V] between two reads of a supply


def require_known_table(number: int, model: int) -> None:
    """Raise `DriverFault` if the registers of a servo are others than this driver's."""
    if not registers.has_known_table(model):
        raise DriverFault(
            f"servo {number}: model {model} has another control table than the X series, so "
            "nothing was written: it needs a rig of your own (docs/how-to/rigs.md)"
        )


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


AS_LIMIT = (
    "has no current-based position mode known to this driver: set current_limit to null and limit "
    "the torque by the servo's PWM Limit"
)
AS_CELL = "measures no current known to this driver: connect a load cell (slave.rig.cells)"


def require_current_unit(number: int, model: int, reason: str) -> float:
    """Return the unit [A] of a servo's currents; `DriverFault` with a reason if it has none."""
    unit = registers.CURRENT_UNITS.get(model)
    if unit is None:
        raise DriverFault(f"servo {number}: model {model} {reason}")
    return unit


def find_other_settings(
    bus: ServoBus, number: int, limits_current: bool
) -> list[tuple[Register, int, int]]:
    """Return the registers left by other programs that a driver sets: what is there, and to."""
    shutdown = bus.get(number, registers.SHUTDOWN) | registers.SHUTDOWN_ERRORS
    settings = (*registers.list_settings(limits_current), (registers.SHUTDOWN, shutdown))
    read = [(register, bus.get(number, register), value) for register, value in settings]
    return [entry for entry in read if entry[1] != entry[2]]


def find_status_address(bus: ServoBus, number: int) -> int:
    """Return where a servo shows what `INDIRECT_ADDRESSES` name; `DriverFault` if nowhere."""
    known = [bus.get(number, each) for each in (registers.INPUT_VOLTAGE, registers.TEMPERATURE)]
    for address in registers.INDIRECT_DATA:
        shown = Register("Indirect Data", address, registers.STATUS_SIZE)
        with suppress(DriverFault):  # beyond its table
            data = bus.get(number, shown).to_bytes(shown.size, "little")
            (status,) = registers.parse_status(data)
            volts, degrees = int(status["voltage"]), int(status["temperature"])
            if abs(volts - known[0]) <= VOLTS_MARGIN and abs(degrees - known[1]) <= 1:
                return address
    raise DriverFault(f"servo {number}: its Indirect Data are at no address known to this driver")
