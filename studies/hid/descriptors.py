"""Report descriptors of real devices, assembled from their published layouts.

A small assembler, and one function a device. The order and the sizes of the fields, the report
numbers, the ranges and the traps are the devices'; the bytes in between are ours. The sources are
the firmware of each project (Ultrawipf/OpenFFBoard, YukMingLaw/ArduinoJoystickWithFFBLibrary,
walmis/VPforce-TelemFFB, ffbeast.github.io) and of the Linux drivers (hid-playstation, hid-lg4ff).
"""

from collections.abc import Iterable

DATA_ARRAY, VARIABLE, CONSTANT, NULL = 0x00, 0x02, 0x03, 0x42

INPUT, OUTPUT, FEATURE = 0x80, 0x90, 0xB0
PHYSICAL, APPLICATION, LOGICAL = 0x00, 0x01, 0x02

DESKTOP, SIMULATION, BUTTON, ORDINAL, PID, VENDOR = 0x01, 0x02, 0x09, 0x0A, 0x0F, 0xFF00
POINTER, JOYSTICK, GAMEPAD, MULTI_AXIS = 0x01, 0x04, 0x05, 0x08
X, Y, Z, RX, RY, RZ, SLIDER, DIAL, HAT = 0x30, 0x31, 0x32, 0x33, 0x34, 0x35, 0x36, 0x37, 0x39
BYTE_COUNT = 0x3B

EFFECT_TYPES = (0x26, 0x27, 0x30, 0x31, 0x32, 0x33, 0x34, 0x40, 0x41, 0x42, 0x43)
CUSTOM_FORCE = 0x28
ENABLE, DISABLE, STOP_ALL, RESET, PAUSE, CONTINUE = 0x97, 0x98, 0x99, 0x9A, 0x9B, 0x9C
MILLISECONDS = (0x1003, 0xFD)  # unit, and exponent -3 as the firmwares write it


def item(prefix: int, value: int = 0, width: int | None = None) -> bytes:
    """Return a short item of 0, 1, 2 or 4 bytes; the least that hold the value if None."""
    if width is None:
        width = next(w for w in (1, 2, 4) if -(1 << 8 * w - 1) <= value < 1 << 8 * w)
    code = {0: 0, 1: 1, 2: 2, 4: 3}[width]
    return bytes([prefix | code]) + (value & (1 << 8 * width) - 1).to_bytes(width, "little")


def signed(prefix: int, value: int) -> bytes:
    """Return an item whose value is read as a signed number."""
    width = next(w for w in (1, 2, 4) if -(1 << 8 * w - 1) <= value < 1 << 8 * w - 1)
    return item(prefix, value, width)


def page(number: int) -> bytes:
    return item(0x04, number)


def usage(*numbers: int) -> bytes:
    """Return usages; above 0xFFFF they carry their page."""
    return b"".join(item(0x08, n) for n in numbers)


def usages_between(first: int, last: int) -> bytes:
    return item(0x18, first) + item(0x28, last)


def logical(low: int, high: int) -> bytes:
    return signed(0x14, low) + signed(0x24, high)


def physical(low: int, high: int) -> bytes:
    return signed(0x34, low) + signed(0x44, high)


def unit(code: int, exponent: int) -> bytes:
    return item(0x64, code) + item(0x54, exponent)


def report(number: int) -> bytes:
    return item(0x84, number)


def shape(bits: int, count: int = 1) -> bytes:
    return item(0x74, bits) + item(0x94, count)


def collection(kind: int, *inside: bytes) -> bytes:
    return item(0xA0, kind) + b"".join(inside) + item(0xC0, width=0)


def main(kind: int, flags: int = VARIABLE) -> bytes:
    return item(kind, flags)


def pad(kind: int, bits: int) -> bytes:
    return shape(bits) + main(kind, CONSTANT)


def field(
    kind: int, bits: int, low: int, high: int, *usages: int, flags: int = VARIABLE, count: int = 0
) -> bytes:
    """Return a whole field: one of `bits` for each usage, or `count` of them."""
    count = count or len(usages)
    return usage(*usages) + logical(low, high) + shape(bits, count) + main(kind, flags)


def named_array(kind: int, name: int, values: Iterable[int]) -> bytes:
    """Return an array that selects one of `values` by its place, the first of them by 1."""
    values = tuple(values)
    choose = field(kind, 8, 1, len(values), *values, flags=DATA_ARRAY, count=1)
    return usage(name) + collection(LOGICAL, choose)


def milliseconds(bits: int, high: int, *usages: int) -> bytes:
    return unit(*MILLISECONDS) + field(OUTPUT, bits, 0, high, *usages) + unit(0, 0)


def hat() -> bytes:
    angle = physical(0, 315) + unit(0x14, 0)
    return angle + field(INPUT, 4, 0, 7, HAT, flags=NULL) + physical(0, 0) + unit(0, 0)


def ordinals(n: int) -> tuple[int, ...]:
    return tuple(ORDINAL << 16 | k for k in range(1, n + 1))


def buttons(first: int, last: int) -> bytes:
    return (
        page(BUTTON)
        + usages_between(first, last)
        + logical(0, 1)
        + shape(1, last - first + 1)
        + main(INPUT)
    )


def block_index(kind: int = OUTPUT, blocks: int = 40) -> bytes:
    return field(kind, 8, 1, blocks, 0x22)


def pid_report(name: int, number: int, *inside: bytes) -> bytes:
    return page(PID) + usage(name) + collection(LOGICAL, report(number), *inside)


def axes_enable(axes: int, spare: bytes = b"") -> bytes:
    """Return one bit for each axis, one for the direction, and the rest of the byte."""
    return (
        usage(0x55)
        + collection(LOGICAL, page(DESKTOP), field(OUTPUT, 1, 0, 1, *(X, Y, Z)[:axes]))
        + page(PID)
        + field(OUTPUT, 1, 0, 1, 0x56)
        + (spare or pad(OUTPUT, 7 - axes))
    )


def directions(axes: int, bits: int, high: int) -> bytes:
    return usage(0x57) + collection(
        LOGICAL, physical(0, 36000), field(OUTPUT, bits, 0, high, *ordinals(axes)), physical(0, 0)
    )


def block_offsets(kind: int, bits: int, n: int, high: int) -> bytes:
    return page(PID) + usage(0x58) + collection(LOGICAL, field(kind, bits, 0, high, *ordinals(n)))


def condition(number: int, full: int) -> bytes:
    return pid_report(
        0x5F,
        number,
        block_index(),
        field(OUTPUT, 4, 0, 3, 0x23),
        block_offsets(OUTPUT, 2, 2, 3),
        field(OUTPUT, 16, -full, full, 0x60),
        field(OUTPUT, 16, -full, full, 0x61, 0x62),
        field(OUTPUT, 16, 0, full, 0x63, 0x64, 0x65),
    )


def envelope(number: int, full: int) -> bytes:
    return pid_report(
        0x5A,
        number,
        block_index(),
        field(OUTPUT, 16, 0, full, 0x5B, 0x5D),
        milliseconds(32, 32767, 0x5C, 0x5E),
    )


def periodic(number: int, full: int) -> bytes:
    return pid_report(
        0x6E,
        number,
        block_index(),
        field(OUTPUT, 16, 0, full, 0x70),
        field(OUTPUT, 16, -full, full, 0x6F),
        field(OUTPUT, 16, 0, 35999, 0x71),
        milliseconds(32, 32767, 0x72),
    )


def constant_force(number: int, full: int, blocks: int = 40) -> bytes:
    return pid_report(
        0x73, number, block_index(blocks=blocks), field(OUTPUT, 16, -full, full, 0x70)
    )


def ramp(number: int, full: int, blocks: int = 40) -> bytes:
    return pid_report(
        0x74, number, block_index(blocks=blocks), field(OUTPUT, 16, -full, full, 0x75, 0x76)
    )


def operation(number: int, blocks: int = 40) -> bytes:
    return pid_report(
        0x77,
        number,
        block_index(blocks=blocks),
        named_array(OUTPUT, 0x78, (0x79, 0x7A, 0x7B)),
        field(OUTPUT, 8, 0, 255, 0x7C),
    )


def control_array(number: int, *order: int) -> bytes:
    return pid_report(0x95, number, named_array(OUTPUT, 0x96, order))


def control_mask(number: int) -> bytes:
    """Return eight bits for six usages, with a range that no bit can hold, as OpenFFBoard has."""
    bits = field(
        OUTPUT, 1, 1, 6, ENABLE, DISABLE, STOP_ALL, RESET, PAUSE, CONTINUE, flags=VARIABLE, count=8
    )
    return pid_report(0x95, number, usage(0x96), collection(LOGICAL, bits))


def creation(number: int, types: Iterable[int]) -> bytes:
    return pid_report(
        0xAB,
        number,
        named_array(FEATURE, 0x25, types),
        page(DESKTOP),
        field(FEATURE, 10, 0, 511, BYTE_COUNT),
        pad(FEATURE, 6),
    )


def block_load(number: int, blocks: int = 40) -> bytes:
    return pid_report(
        0x89,
        number,
        block_index(FEATURE, blocks),
        named_array(FEATURE, 0x8B, (0x8C, 0x8D, 0x8E)),
        field(FEATURE, 16, 0, 65535, 0xAC),
    )


def pool(number: int) -> bytes:
    return pid_report(
        0x7F,
        number,
        field(FEATURE, 16, 0, 65535, 0x80),
        field(FEATURE, 8, 0, 255, 0x83),
        field(FEATURE, 1, 0, 1, 0xA9, 0xAA),
        pad(FEATURE, 6),
    )


def block_free(number: int, blocks: int = 40) -> bytes:
    return pid_report(0x90, number, block_index(blocks=blocks))


def device_gain(number: int) -> bytes:
    return pid_report(0x7D, number, field(OUTPUT, 8, 0, 255, 0x7E))


def effect_reports(
    base: int,
    axes: int,
    full: int,
    control: bytes,
    features: tuple[int, int, int] = (0x11, 0x12, 0x13),
    types: tuple[int, ...] = EFFECT_TYPES,
    choose_type: bytes = b"",
    times: tuple[int, ...] = (0x50, 0x54, 0x51, 0xA7),
    direction: tuple[int, int] = (16, 36000),
) -> bytes:
    """Return the reports of a firmware in the order of the standard, numbered from `base` on."""
    set_effect = pid_report(
        0x21,
        base + 0x01,
        block_index(),
        choose_type or named_array(OUTPUT, 0x25, types),
        milliseconds(16, 32767, *times),
        field(OUTPUT, 8, 0, 255, 0x52),
        field(OUTPUT, 8, 1, 8, 0x53),
        axes_enable(axes),
        directions(axes, *direction),
        block_offsets(OUTPUT, 16, axes, 32765),
    )
    rest = (
        envelope(base + 0x02, full),
        condition(base + 0x03, full),
        periodic(base + 0x04, full),
        constant_force(base + 0x05, full),
        ramp(base + 0x06, full),
        operation(base + 0x0A),
        block_free(base + 0x0B),
        control,
        device_gain(base + 0x0D),
        creation(features[0], types),
        block_load(features[1]),
        pool(features[2]),
    )
    return set_effect + b"".join(rest)


def device(kind: int, *inside: bytes) -> bytes:
    return page(DESKTOP) + usage(kind) + collection(APPLICATION, *inside)


def openffboard(axes: int = 2) -> bytes:
    """Return the descriptor of OpenFFBoard with one or two axes: a mask to control the device."""
    vendor = [
        usage(n) + shape(bits) + main(kind)
        for kind in (OUTPUT, INPUT)
        for n, bits in enumerate((8, 16, 8, 32, 64, 64), start=1)
    ]
    return device(
        JOYSTICK,
        collection(
            PHYSICAL,
            report(0x01),
            buttons(1, 64),
            page(DESKTOP),
            field(INPUT, 16, -32767, 32767, X, Y, Z, RX, RY, RZ, DIAL, SLIDER),
        ),
        page(VENDOR),
        usage(0x00),
        collection(APPLICATION, report(0xA1), logical(0, 4), *vendor),
        pid_report(0x92, 0x02, field(INPUT, 1, 0, 1, 0x9F, 0xA0, 0xA4, 0xA6, 0x94), pad(INPUT, 3)),
        effect_reports(0x00, axes, 32767, control_mask(0x0C)),
    )


def arduino(n_buttons: int = 32) -> bytes:
    """Return a sketch with X and Y on the Arduino library: no start delay, directions of a byte.

    The library lists one effect type twice, and its output reports share numbers with its feature
    reports.
    """
    types = (*EFFECT_TYPES, CUSTOM_FORCE)
    twice = field(OUTPUT, 8, 1, 12, *types, CUSTOM_FORCE, flags=DATA_ARRAY, count=1)
    state = pid_report(
        0x92,
        0x02,
        field(INPUT, 1, 0, 1, 0x9F, 0xA0, 0xA4, 0xA5, 0xA6),
        pad(INPUT, 3),
        field(INPUT, 1, 0, 1, 0x94),
        field(INPUT, 7, 1, 40, 0x22),
    )
    return device(
        JOYSTICK,
        report(0x01),
        buttons(1, n_buttons),
        *([pad(INPUT, -n_buttons % 8)] if n_buttons % 8 else []),
        page(DESKTOP),
        hat(),
        pad(INPUT, 4),
        usage(POINTER),
        collection(PHYSICAL, field(INPUT, 16, -32767, 32767, X, Y)),
        state,
        effect_reports(
            0x00,
            2,
            10000,
            control_array(0x0C, ENABLE, DISABLE, STOP_ALL, RESET, PAUSE, CONTINUE),
            (0x05, 0x06, 0x07),
            types,
            usage(0x25) + collection(LOGICAL, twice),
            (0x50, 0x54, 0x51),
            (8, 255),
        ),
    )


def rhino() -> bytes:
    """Return the VPforce Rhino: *disable* comes before *enable*, the start delay comes last."""
    blocks = 64
    types = (*EFFECT_TYPES, CUSTOM_FORCE)
    # the game, or the maker's own program
    source = page(VENDOR) + field(OUTPUT, 1, 0, 1, 0x20) + page(PID) + pad(OUTPUT, 4)
    set_effect = pid_report(
        0x21,
        101,
        block_index(blocks=blocks),
        named_array(OUTPUT, 0x25, types),
        milliseconds(16, 65535, 0x50, 0x54, 0x51),
        field(OUTPUT, 16, 0, 4096, 0x52),
        field(OUTPUT, 8, 1, 8, 0x53),
        axes_enable(2, spare=source),
        directions(2, 8, 255),
        page(PID),
        field(OUTPUT, 16, 0, 65535, 0xA7),
    )
    set_condition = pid_report(
        0x5F,
        103,
        block_index(blocks=blocks),
        field(OUTPUT, 8, 0, 1, 0x23),
        field(OUTPUT, 16, -4096, 4096, 0x60, 0x61, 0x62),
        field(OUTPUT, 16, 0, 4096, 0x63, 0x64, 0x65),
    )
    inputs = (
        report(0x01)
        + page(DESKTOP)
        + field(INPUT, 16, -4096, 4096, X, Y, Z)
        + field(INPUT, 8, 0, 255, RZ, RY, RX, SLIDER)
        + buttons(1, 48)
        + page(DESKTOP)
        + field(INPUT, 4, 0, 7, HAT, HAT, HAT, HAT, flags=NULL)
        + buttons(49, 64)
        + page(VENDOR)
        + field(INPUT, 16, -4096, 4096, 0x30, 0x31, 0x32, 0x33, 0x34, 0x35)
        + field(INPUT, 8, 0, 255, 0x36)
    )
    state = (
        block_index(INPUT, blocks)
        + field(INPUT, 1, 0, 1, 0x94, 0x9F, 0xA0, 0xA4, 0xA6)
        + pad(INPUT, 3)
    )
    return device(
        JOYSTICK,
        inputs,
        pid_report(0x92, 2, state),
        set_effect,
        set_condition,
        constant_force(105, 4096, blocks),
        ramp(106, 4096, blocks),
        operation(110, blocks),
        block_free(111, blocks),
        control_array(112, DISABLE, ENABLE, STOP_ALL, RESET, PAUSE, CONTINUE),
        device_gain(113),
        creation(5, types),
        block_load(6, blocks),
        pool(7),
        page(VENDOR),
        report(0x56) + field(FEATURE, 8, 0, 255, 0x56, count=16),
        report(0x57) + field(FEATURE, 8, 0, 255, 0x57, count=2),
    )


def ffbeast_pid() -> bytes:
    """Return the joystick interface of an FFBeast wheel: one unsigned axis, numbers from 0x10."""
    return device(
        JOYSTICK,
        report(0x01),
        buttons(1, 32),
        page(DESKTOP),
        field(INPUT, 16, 0, 65535, X),
        pid_report(0x92, 0x12, field(INPUT, 1, 0, 1, 0x9F, 0xA0, 0xA4, 0xA6, 0x94), pad(INPUT, 3)),
        effect_reports(0x10, 1, 10000, control_mask(0x1C)),
    )


def ffbeast_vendor() -> bytes:
    """Return the interface of an FFBeast wheel that takes torque: 64 bytes either way."""
    return (
        page(VENDOR)
        + usage(0x01)
        + collection(
            APPLICATION,
            report(0xA3),
            field(INPUT, 8, 0, 255, 0x01, count=64),
            field(OUTPUT, 8, 0, 255, 0x02, count=64),
            report(0x21),
            field(FEATURE, 8, 0, 255, 0x03, count=64),
            report(0x22),
            field(FEATURE, 8, 0, 255, 0x04, count=64),
        )
    )


def dualsense_usb() -> bytes:
    """Return a DualSense on USB: sticks, triggers, hat, 15 buttons, and much that is not named."""
    features = ((0x05, 40), (0x08, 47), (0x09, 19), (0x0A, 26), (0x20, 63), (0x22, 63))
    return device(
        GAMEPAD,
        report(0x01),
        field(INPUT, 8, 0, 255, X, Y, Z, RZ, RX, RY),
        page(VENDOR),
        field(INPUT, 8, 0, 255, 0x20),
        page(DESKTOP),
        hat(),
        buttons(1, 15),
        page(VENDOR),
        field(INPUT, 1, 0, 1, 0x21, count=13),
        field(INPUT, 8, 0, 255, 0x22, count=52),
        report(0x02),
        field(OUTPUT, 8, 0, 255, 0x23, count=47),
        *(report(n) + field(FEATURE, 8, 0, 255, n, count=count) for n, count in features),
    )


def spacemouse(old: bool = False) -> bytes:
    """Return a SpaceMouse: all six axes in one report, or three and three in older ones."""
    axes = (X, Y, Z, RX, RY, RZ)
    if old:
        motion = [
            report(number) + field(INPUT, 16, -500, 500, *axes[part])
            for number, part in ((1, slice(0, 3)), (2, slice(3, 6)))
        ]
    else:
        scale = physical(-1400, 1400) + unit(0x11, 0x0C)
        ranged = field(INPUT, 16, -350, 350, *axes)
        motion = [report(1) + scale + ranged + physical(0, 0) + unit(0, 0)]
    return device(
        MULTI_AXIS,
        *(usage(POINTER) + collection(PHYSICAL, inside) for inside in motion),
        usage(0x3A),
        collection(LOGICAL, report(3), buttons(1, 2), pad(INPUT, 14)),
        page(0x08),
        usage(0x4B),
        collection(LOGICAL, report(4), field(OUTPUT, 1, 0, 1, 0x4B), pad(OUTPUT, 7)),
        page(VENDOR),
        usage(0x17),
        collection(LOGICAL, report(0x17), field(INPUT, 8, 0, 255, 0x17, count=2)),
    )


def logitech_g29() -> bytes:
    """Return a G29 in PS3 mode: no report numbers, commands of seven bytes.

    That the pedals are Z, Rz and Y is not confirmed; where they stand is.
    """
    return device(
        JOYSTICK,
        hat(),
        buttons(1, 25),
        page(VENDOR),
        field(INPUT, 1, 0, 1, 0x01, count=3),
        page(DESKTOP),
        field(INPUT, 16, 0, 65535, X),
        field(INPUT, 8, 0, 255, Z, RZ, Y),
        page(VENDOR),
        field(INPUT, 8, 0, 255, 0x02, count=3),
        field(OUTPUT, 8, 0, 255, 0x03, count=7),
    )


LAYOUTS = {
    "openffboard 2": openffboard(2),
    "openffboard 1": openffboard(1),
    "arduino": arduino(),
    "rhino": rhino(),
    "ffbeast pid": ffbeast_pid(),
    "ffbeast vendor": ffbeast_vendor(),
    "dualsense": dualsense_usb(),
    "spacemouse": spacemouse(),
    "spacemouse old": spacemouse(old=True),
    "logitech g29": logitech_g29(),
}
