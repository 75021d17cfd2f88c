"""Effects in the memory of a PID device: create, set, start and free."""

from collections.abc import Container

from master.devices.hid import usages as U  # noqa: N812
from master.devices.hid.bits import compute_limits, read_field, scale_share
from master.devices.hid.descriptor import ReportField
from master.devices.hid.driver import DriverError, ReportAccess, Share
from master.devices.hid.pid_layout import FORCE_AXES, FieldValue, PidLayout, ReportPart

DURATION_S = 0.2  # [s] of every effect; must be restarted well within
_SECONDS = (0x1001, 0x1003)  # unit codes
_LOAD_READS = 60  # hid-pidff of Linux asks as often


def create_effect(layout: PidLayout, device: ReportAccess, usage: int, ours: Container[int]) -> int:
    """Return the number of a new effect; `DriverError` if the device has none free.

    If its memory is full, effects of earlier programs are freed: all numbers except `ours`.
    """
    report = layout.creation.packed([layout.creation.choose(usage)])
    device.send_feature(report)
    block, full = _read_block_load(layout.block_load, device)
    if full and layout.block_free is not None:
        low, high = compute_limits(layout.block_free.need(U.BLOCK_INDEX))
        for other in range(max(low, 1), min(high, 255) + 1):
            if other not in ours:
                device.write(_build_block_report(layout.block_free, other))
        device.send_feature(report)
        block, full = _read_block_load(layout.block_load, device)
    if full:
        raise DriverError("its memory for effects is full")
    if not block:
        raise DriverError(f"it did not create the effect ({U.format_usage(usage)})")
    return block


def _read_block_load(part: ReportPart, device: ReportAccess) -> tuple[int, bool]:
    """Return the number of the effect just made, 0 = none, and whether memory is full.

    The first valid answer is used: some firmware clears it on reading.
    """
    status, index = part.need(U.LOAD_SUCCESS), part.need(U.BLOCK_INDEX)
    success = part.choose(U.LOAD_SUCCESS).value
    full = part.choose(U.LOAD_FULL).value if part.find(U.LOAD_FULL) else None
    for _ in range(_LOAD_READS):
        reply = device.get_feature(part.number, part.length)
        if len(reply) < part.length or reply[0] != part.number:
            continue
        load_status, block = read_field(reply, status), read_field(reply, index)
        if load_status == success and block > 0:
            return block, False
        if load_status == full:
            return 0, True
    return 0, False


def build_effect_report(layout: PidLayout, usage: int, block: int, axis: str) -> bytes:
    """Return Set Effect: `DURATION_S`, full gain, no delay, no trigger button, along `axis`.

    No axis may be enabled with the direction: the Arduino library uses the angle only then.
    """
    part = layout.set_effect
    duration = part.need(U.DURATION)
    choices = [part.choose(usage), FieldValue(duration, compute_duration_ticks(duration))]
    gain = part.find(U.EFFECT_GAIN)
    if gain is not None:
        choices.append(FieldValue(gain, compute_limits(gain)[1]))
    if layout.polar:
        choices.append(part.choose(U.DIRECTION_ENABLE))
    else:
        enable = [f for f in part.within(U.AXES_ENABLE) if U.AXES.get(f.usage) == axis]
        choices += [FieldValue(field, 1) for field in enable]
    directions = part.within(U.DIRECTION)
    if directions:
        low, high = compute_limits(directions[0])
        angle = low + round((high - low) * FORCE_AXES[axis] / 360.0)
        choices.append(FieldValue(directions[0], angle))
    return _build_block_report(part, block, *choices)


def compute_duration_ticks(duration: ReportField) -> int:
    """Return `DURATION_S` in units of the field; `DriverError` if it does not fit."""
    exponent = duration.exponent if duration.unit in _SECONDS else -3
    tick = 10.0 ** max(-9, min(9, exponent))  # [s]
    count = round(DURATION_S / tick)
    if not 1 <= count <= compute_limits(duration)[1]:  # zero would be infinite
        raise DriverError(f"its effects cannot have a duration of {DURATION_S} s")
    return count


def build_condition_reports(layout: PidLayout, block: int, share: Share) -> tuple[bytes, ...]:
    """Return Set Condition for each axis: centred, no dead band, `share` of the maximum.

    `DriverError` if the device has no conditions, or not per axis.
    """
    part = layout.condition
    if part is None:
        raise DriverError("no Set Condition report, so neither spring nor damper")
    choices = [
        FieldValue(f, scale_share(share, compute_limits(f)[1]))
        for f in _find_fields(part, _COEFFICIENTS)
    ]
    choices += [
        FieldValue(f, scale_share(share, compute_limits(f)[1]))
        for f in _find_fields(part, _SATURATIONS)
    ]
    if not choices:
        raise DriverError(f"{part.name} has no {U.format_usage(U.POSITIVE_COEFFICIENT)}")
    if layout.forces == ("x",) and part.find(U.PARAMETER_BLOCK_OFFSET) is None:
        return (_build_block_report(part, block, *choices),)
    offset = part.need(U.PARAMETER_BLOCK_OFFSET)
    numbers = [list(FORCE_AXES).index(axis) for axis in layout.forces]
    return tuple(
        _build_block_report(part, block, FieldValue(offset, number), *choices) for number in numbers
    )


_COEFFICIENTS = (U.POSITIVE_COEFFICIENT, U.NEGATIVE_COEFFICIENT)
_SATURATIONS = (U.POSITIVE_SATURATION, U.NEGATIVE_SATURATION)


def _find_fields(part: ReportPart, usages: tuple[int, ...]) -> list[ReportField]:
    return [field for usage in usages if (field := part.find(usage)) is not None]


def build_zero_force_report(layout: PidLayout, block: int) -> bytes:
    """Return Set Constant Force with zero force."""
    return _build_block_report(layout.constant_force, block)


def build_start_report(layout: PidLayout, block: int) -> bytes:
    """Return the report that starts or restarts an effect, with a loop count of one."""
    part = layout.operation
    loops = part.find(U.LOOP_COUNT)
    once = [FieldValue(loops, 1)] if loops is not None else []
    return _build_block_report(part, block, part.choose(U.OP_START), *once)


def build_stop_report(layout: PidLayout, block: int) -> bytes:
    """Return the report that stops an effect."""
    return _build_block_report(layout.operation, block, layout.operation.choose(U.OP_STOP))


def build_free_reports(layout: PidLayout, block: int) -> tuple[bytes, ...]:
    """Return the report that frees an effect, if the device has one."""
    return (_build_block_report(layout.block_free, block),) if layout.block_free is not None else ()


def _build_block_report(part: ReportPart, block: int, *choices: FieldValue) -> bytes:
    return part.packed([FieldValue(part.need(U.BLOCK_INDEX), block), *choices])
