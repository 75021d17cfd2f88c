"""Effects in the memory of a PID device: create, set, start and free."""

from collections.abc import Container

from master.devices.hid import usages as U  # noqa: N812
from master.devices.hid.bits import get, limits, scaled
from master.devices.hid.descriptor import Field
from master.devices.hid.driver import DriverError, Features, Share
from master.devices.hid.pid_layout import FORCE_AXES, Choice, Part, PidLayout

DURATION = 0.2  # [s] of every effect; must be restarted well within
_SECONDS = (0x1001, 0x1003)  # unit codes
_LOAD_READS = 60  # hid-pidff of Linux asks as often


def create(layout: PidLayout, device: Features, usage: int, ours: Container[int]) -> int:
    """Return the number of a new effect; `DriverError` if the device has none free.

    If its memory is full, effects of earlier programs are freed: all numbers except `ours`.
    """
    report = layout.creation.packed([layout.creation.choose(usage)])
    device.send_feature(report)
    block, full = _loaded(layout.block_load, device)
    if full and layout.block_free is not None:
        low, high = limits(layout.block_free.need(U.BLOCK_INDEX))
        for other in range(max(low, 1), min(high, 255) + 1):
            if other not in ours:
                device.write(_about(layout.block_free, other))
        device.send_feature(report)
        block, full = _loaded(layout.block_load, device)
    if full:
        raise DriverError("its memory for effects is full")
    if not block:
        raise DriverError(f"it did not create the effect ({U.name(usage)})")
    return block


def _loaded(part: Part, device: Features) -> tuple[int, bool]:
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
        load_status, block = get(reply, status), get(reply, index)
        if load_status == success and block > 0:
            return block, False
        if load_status == full:
            return 0, True
    return 0, False


def described(layout: PidLayout, usage: int, block: int, axis: str) -> bytes:
    """Return Set Effect: `DURATION`, full gain, no delay, no trigger button, along `axis`.

    No axis may be enabled with the direction: the Arduino library uses the angle only then.
    """
    part = layout.set_effect
    duration = part.need(U.DURATION)
    choices = [part.choose(usage), Choice(duration, ticks(duration))]
    gain = part.find(U.EFFECT_GAIN)
    if gain is not None:
        choices.append(Choice(gain, limits(gain)[1]))
    if layout.polar:
        choices.append(part.choose(U.DIRECTION_ENABLE))
    else:
        enable = [f for f in part.within(U.AXES_ENABLE) if U.AXES.get(f.usage) == axis]
        choices += [Choice(field, 1) for field in enable]
    directions = part.within(U.DIRECTION)
    if directions:
        low, high = limits(directions[0])
        angle = low + round((high - low) * FORCE_AXES[axis] / 360.0)
        choices.append(Choice(directions[0], angle))
    return _about(part, block, *choices)


def ticks(duration: Field) -> int:
    """Return `DURATION` in units of the field; `DriverError` if it does not fit."""
    exponent = duration.exponent if duration.unit in _SECONDS else -3
    tick = 10.0 ** max(-9, min(9, exponent))  # [s]
    count = round(DURATION / tick)
    if not 1 <= count <= limits(duration)[1]:  # zero would be infinite
        raise DriverError(f"its effects cannot have a duration of {DURATION} s")
    return count


def conditions(layout: PidLayout, block: int, share: Share) -> tuple[bytes, ...]:
    """Return Set Condition for each axis: centred, no dead band, `share` of the maximum.

    `DriverError` if the device has no conditions, or not per axis.
    """
    part = layout.condition
    if part is None:
        raise DriverError("no Set Condition report, so neither spring nor damper")
    choices = [Choice(f, scaled(share, limits(f)[1])) for f in _fields(part, _COEFFICIENTS)]
    choices += [Choice(f, scaled(share, limits(f)[1])) for f in _fields(part, _SATURATIONS)]
    if not choices:
        raise DriverError(f"{part.name} has no {U.name(U.POSITIVE_COEFFICIENT)}")
    if layout.forces == ("x",) and part.find(U.PARAMETER_BLOCK_OFFSET) is None:
        return (_about(part, block, *choices),)
    offset = part.need(U.PARAMETER_BLOCK_OFFSET)
    numbers = [list(FORCE_AXES).index(axis) for axis in layout.forces]
    return tuple(_about(part, block, Choice(offset, number), *choices) for number in numbers)


_COEFFICIENTS = (U.POSITIVE_COEFFICIENT, U.NEGATIVE_COEFFICIENT)
_SATURATIONS = (U.POSITIVE_SATURATION, U.NEGATIVE_SATURATION)


def _fields(part: Part, usages: tuple[int, ...]) -> list[Field]:
    return [field for usage in usages if (field := part.find(usage)) is not None]


def magnitude_zero(layout: PidLayout, block: int) -> bytes:
    """Return Set Constant Force with zero force."""
    return _about(layout.constant_force, block)


def start(layout: PidLayout, block: int) -> bytes:
    """Return the report that starts or restarts an effect, with a loop count of one."""
    part = layout.operation
    loops = part.find(U.LOOP_COUNT)
    once = [Choice(loops, 1)] if loops is not None else []
    return _about(part, block, part.choose(U.OP_START), *once)


def stop(layout: PidLayout, block: int) -> bytes:
    """Return the report that stops an effect."""
    return _about(layout.operation, block, layout.operation.choose(U.OP_STOP))


def free(layout: PidLayout, block: int) -> tuple[bytes, ...]:
    """Return the report that frees an effect, if the device has one."""
    return (_about(layout.block_free, block),) if layout.block_free is not None else ()


def _about(part: Part, block: int, *choices: Choice) -> bytes:
    return part.packed([Choice(part.need(U.BLOCK_INDEX), block), *choices])
