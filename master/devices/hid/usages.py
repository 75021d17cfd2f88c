"""Names of HID usages that haptic devices have, and a report descriptor as text.

A usage has its page in the high word and its number in the low one. Numbers from the HID Usage
Tables and the PID class definition 1.0 of the USB-IF.
"""

from itertools import takewhile

from master.devices.hid.descriptor import Collection, HidReport, ReportDescriptor, ReportField

DESKTOP, SIMULATION, BUTTON, ORDINAL, PID, VENDOR = 0x01, 0x02, 0x09, 0x0A, 0x0F, 0xFF00

AXES = {
    0x010030: "x",
    0x010031: "y",
    0x010032: "z",
    0x010033: "rx",
    0x010034: "ry",
    0x010035: "rz",
    0x010036: "slider",
    0x010037: "dial",
    0x010038: "wheel",
    0x0200B0: "aileron",
    0x0200B8: "elevator",
    0x0200BA: "rudder",
    0x0200BB: "throttle",
    0x0200C4: "accelerator",
    0x0200C5: "brake",
    0x0200C6: "clutch",
    0x0200C8: "steering",
}
HAT = 0x010039

SET_EFFECT, SET_CONDITION, SET_CONSTANT_FORCE = 0x0F0021, 0x0F005F, 0x0F0073
EFFECT_OPERATION, DEVICE_CONTROL, DEVICE_GAIN = 0x0F0077, 0x0F0096, 0x0F007D
CREATE_NEW_EFFECT, BLOCK_LOAD, BLOCK_FREE = 0x0F00AB, 0x0F0089, 0x0F0090
DEVICE_CONTROL_REPORT = 0x0F0095  # around the usage above, or instead of it
BLOCK_INDEX, PARAMETER_BLOCK_OFFSET = 0x0F0022, 0x0F0023
CONSTANT_FORCE, SPRING, DAMPER = 0x0F0026, 0x0F0040, 0x0F0041
DURATION, EFFECT_GAIN, TRIGGER_BUTTON = 0x0F0050, 0x0F0052, 0x0F0053
AXES_ENABLE, DIRECTION_ENABLE, DIRECTION = 0x0F0055, 0x0F0056, 0x0F0057
MAGNITUDE, GAIN, LOOP_COUNT = 0x0F0070, 0x0F007E, 0x0F007C
POSITIVE_COEFFICIENT, NEGATIVE_COEFFICIENT = 0x0F0061, 0x0F0062
POSITIVE_SATURATION, NEGATIVE_SATURATION = 0x0F0063, 0x0F0064
OP_START, OP_STOP = 0x0F0079, 0x0F007B
ENABLE_ACTUATORS, DISABLE_ACTUATORS = 0x0F0097, 0x0F0098
STOP_ALL_EFFECTS, DEVICE_RESET, DEVICE_CONTINUE = 0x0F0099, 0x0F009A, 0x0F009C
PAUSED, ACTUATORS_ENABLED, SAFETY_SWITCH, ACTUATOR_POWER = 0x0F009F, 0x0F00A0, 0x0F00A4, 0x0F00A6
LOAD_SUCCESS, LOAD_FULL = 0x0F008C, 0x0F008D

_PAGES = {
    DESKTOP: "generic desktop",
    SIMULATION: "simulation",
    0x08: "LED",
    BUTTON: "button",
    0x0C: "consumer",
    PID: "PID",
}
_NAMES = {
    0x010001: "pointer",
    0x010002: "mouse",
    0x010004: "joystick",
    0x010005: "gamepad",
    0x010008: "multi-axis controller",
    HAT: "hat",
    0x01003B: "byte count",
    0x0F0001: "physical interface device",
    0x0F0020: "normal",
    SET_EFFECT: "Set Effect",
    BLOCK_INDEX: "effect block index",
    PARAMETER_BLOCK_OFFSET: "parameter block offset",
    0x0F0025: "effect type",
    CONSTANT_FORCE: "constant force",
    0x0F0027: "ramp",
    0x0F0028: "custom force",
    0x0F0030: "square",
    0x0F0031: "sine",
    0x0F0032: "triangle",
    0x0F0033: "sawtooth up",
    0x0F0034: "sawtooth down",
    SPRING: "spring",
    DAMPER: "damper",
    0x0F0042: "inertia",
    0x0F0043: "friction",
    DURATION: "duration",
    0x0F0051: "sample period",
    EFFECT_GAIN: "effect gain",
    TRIGGER_BUTTON: "trigger button",
    0x0F0054: "trigger repeat interval",
    AXES_ENABLE: "axes enable",
    DIRECTION_ENABLE: "direction enable",
    DIRECTION: "direction",
    0x0F0058: "type specific block offset",
    0x0F005A: "Set Envelope",
    0x0F005B: "attack level",
    0x0F005C: "attack time",
    0x0F005D: "fade level",
    0x0F005E: "fade time",
    SET_CONDITION: "Set Condition",
    0x0F0060: "centre point offset",
    POSITIVE_COEFFICIENT: "positive coefficient",
    NEGATIVE_COEFFICIENT: "negative coefficient",
    POSITIVE_SATURATION: "positive saturation",
    NEGATIVE_SATURATION: "negative saturation",
    0x0F0065: "dead band",
    0x0F006E: "Set Periodic",
    0x0F006F: "offset",
    MAGNITUDE: "magnitude",
    0x0F0071: "phase",
    0x0F0072: "period",
    SET_CONSTANT_FORCE: "Set Constant Force",
    0x0F0074: "Set Ramp Force",
    0x0F0075: "ramp start",
    0x0F0076: "ramp end",
    EFFECT_OPERATION: "Effect Operation",
    0x0F0078: "operation",
    OP_START: "start",
    0x0F007A: "start solo",
    OP_STOP: "stop",
    LOOP_COUNT: "loop count",
    DEVICE_GAIN: "Device Gain",
    GAIN: "device gain",
    0x0F007F: "Pool",
    0x0F0080: "RAM pool size",
    0x0F0083: "simultaneous effects max",
    BLOCK_LOAD: "Block Load",
    0x0F008B: "block load status",
    LOAD_SUCCESS: "success",
    LOAD_FULL: "full",
    0x0F008E: "error",
    BLOCK_FREE: "Block Free",
    0x0F0092: "PID State",
    0x0F0094: "effect playing",
    DEVICE_CONTROL_REPORT: "Device Control",
    DEVICE_CONTROL: "Device Control",
    ENABLE_ACTUATORS: "enable actuators",
    DISABLE_ACTUATORS: "disable actuators",
    STOP_ALL_EFFECTS: "stop all effects",
    DEVICE_RESET: "device reset",
    0x0F009B: "device pause",
    DEVICE_CONTINUE: "device continue",
    PAUSED: "paused",
    ACTUATORS_ENABLED: "actuators enabled",
    SAFETY_SWITCH: "safety switch",
    0x0F00A5: "actuator override switch",
    ACTUATOR_POWER: "actuator power",
    0x0F00A7: "start delay",
    0x0F00A9: "device managed pool",
    0x0F00AA: "shared parameter blocks",
    CREATE_NEW_EFFECT: "Create New Effect",
    0x0F00AC: "RAM pool available",
}


def format_usage(usage: int) -> str:
    """Return the name of `usage`; page and number if it is not listed here."""
    name = _NAMES.get(usage) or AXES.get(usage)
    if name:
        return name
    page, number = usage >> 16, usage & 0xFFFF
    if page == BUTTON:
        return f"button {number}"
    if page == ORDINAL:
        return f"instance {number}"
    if page >= VENDOR:
        return f"vendor {page:04X}:{number:04X}"
    return f"{_PAGES.get(page, f'page {page:02X}')} {number:02X}"


# --- text of a report descriptor, for `teleop devices probe`

_CHOICES_MAX = 16  # of an array that are listed
_SECONDS, _DEGREES = (0x1001, 0x1003), (0x14, 0x12)  # unit codes; rotation in degrees or radians


def describe_descriptor(descriptor: ReportDescriptor) -> list[str]:
    """Return lines of text: the device, then one block per report."""
    lines = [f"{format_usage(usage)}" for usage in descriptor.applications]
    for report in descriptor.reports:
        lines.append(_format_headline(report))
        lines += [
            f"  {_format_position(group[0])}: {_format_meaning(group)}"
            for group in _group_fields(report)
        ]
    return lines


def _format_headline(report: HidReport) -> str:
    number = f" {report.number} (0x{report.number:02X})" if report.number else ""
    purpose = _format_purpose(report)
    return f"{report.kind.value} report{number}, {report.length} bytes{purpose}"


def _format_purpose(report: HidReport) -> str:
    """Return the name of the innermost collection common to all fields."""
    paths = [field.path for field in report.fields]
    if not paths:
        return ""
    levels = zip(*paths, strict=False)
    shared: list[Collection] = [
        level[0] for level in takewhile(lambda level: len(set(level)) == 1, levels)
    ]
    return f": {format_usage(shared[-1].usage)}" if shared and shared[-1].usage else ""


def _group_fields(report: HidReport) -> list[list[ReportField]]:
    """Return the fields in order, with rows of similar fields grouped."""
    groups: list[list[ReportField]] = []
    for field in report.fields:
        if groups and _is_continuation(groups[-1][-1], field):
            groups[-1].append(field)
        else:
            groups.append([field])
    return groups


def _is_continuation(previous: ReportField, field: ReportField) -> bool:
    return (
        previous.usage >> 16 in (BUTTON, ORDINAL)
        and not previous.array
        and field.usage == previous.usage + 1
        and field.path == previous.path
        and field.offset == previous.offset + previous.size
        and (field.size, field.minimum, field.maximum)
        == (previous.size, previous.minimum, previous.maximum)
    )


def _format_position(field: ReportField) -> str:
    byte, bit = divmod(field.offset, 8)
    return f"byte {byte}" if not bit and not field.size % 8 else f"byte {byte} bit {bit}"


def _format_meaning(group: list[ReportField]) -> str:
    first, last = group[0], group[-1]
    if first.array:
        name = format_usage(first.path[-1].usage) if first.path else "one of"
    else:
        name = format_usage(first.usage) if first.usage else "not named"
        if first.usage >> 16 == ORDINAL:
            name = f"{format_usage(first.path[-1].usage)}, {name}" if first.path else name
    if last is not first:
        name += f" ... {format_usage(last.usage)}"
    bits = f"{first.size} bit{'s' if first.size > 1 else ''}"
    count = len(group) if last is not first else first.count
    shape = f"{count} times {bits}" if count > 1 else bits
    words = [name, shape, f"{first.minimum} ... {first.maximum}{_format_unit(first)}"]
    flags = {
        "constant": first.constant, "relative": first.relative, "may be none": first.nullable
    }  # fmt: skip
    words += [word for word, is_set in flags.items() if is_set]
    text = ", ".join(words)
    return f"{text}: {_format_choices(first)}" if first.array else text


def _format_choices(field: ReportField) -> str:
    names = [
        f"{field.minimum + k} {format_usage(usage)}"
        for k, usage in enumerate(field.usages[:_CHOICES_MAX])
    ]
    return ", ".join(names) + (", ..." if len(field.usages) > _CHOICES_MAX else "")


def _format_unit(field: ReportField) -> str:
    """Return the physical range if it differs from the logical one."""
    symbol = " s" if field.unit in _SECONDS else ""
    if field.unit in _DEGREES:
        symbol = " deg" if field.unit == _DEGREES[0] else " rad"
    low, high = field.physical_minimum, field.physical_maximum
    ranged = (low, high) not in ((0, 0), (field.minimum, field.maximum))
    power = f"e{field.exponent}" if field.exponent else ""
    if ranged:
        return f" (physical {low}{power} ... {high}{power}{symbol})"
    return f" (times 1{power}{symbol})" if symbol else ""
