"""Any force-feedback device of the USB PID class, driven by its report descriptor.

One constant-force effect for each axis, made once and updated by its magnitude. Its duration is
finite and short: the force ends if the host does not restart it. A spring and a damper can be
rendered by the device, whose loop is faster than ours.
"""

from collections.abc import Container
from dataclasses import dataclass
from typing import NamedTuple

from master.devices.hid import usages as U  # noqa: N812
from master.devices.hid.descriptor import (
    DescriptorError,
    ReportField,
    compute_limits,
    parse_descriptor,
    read_field,
    scale_share,
)
from master.devices.hid.driver import (
    ActuatorReports,
    ActuatorState,
    Controls,
    DriverError,
    ReportAccess,
    Share,
)
from master.devices.hid.input_report import InputReportDecoder
from master.devices.hid.pid_layout import (
    FORCE_AXES,
    FieldValue,
    PidLayout,
    ReportPart,
    build_layout,
)
from teleop.config.ranges import RangedConfig, build_ranged_field

# A direction is where the force comes from, clockwise from -y. One from +x (90 deg) pushes
# towards -x, one from -y (0 deg) towards +y.
_SIGNS = {"x": -1, "y": 1}


@dataclass(frozen=True, slots=True)
class PidConfig(RangedConfig):
    """Effects rendered by the device about its centre while a force is active."""

    # share of the largest coefficient and force, 0 = none
    spring: float = build_ranged_field(0.0, 0.0, 1.0)
    # share of the largest coefficient and force, 0 = none
    damper: float = build_ranged_field(0.0, 0.0, 1.0)


class _Effect(NamedTuple):
    """An effect in the device's memory, and the reports that start and stop it."""

    block: int
    start: bytes
    stop: bytes


class _ConstantForce(NamedTuple):
    """What a constant force is pushed by."""

    zero: bytes  # Set Constant Force without a magnitude
    bits: int  # the same as a little-endian number
    full: int  # magnitude at full scale, with the sign of the axis


class PidDriver:
    """A `master.devices.hid.driver.HidDriver`.

    `config` has effects in addition to the force, `pushed` the axes to be pushed, all by default;
    each takes an effect of the device's memory. A `DriverError` lists everything that the device
    lacks, or the error in its descriptor.
    """

    def __init__(
        self,
        descriptor: bytes,
        config: PidConfig | None = None,
        pushed: tuple[str, ...] | None = None,
    ) -> None:
        try:
            parsed = parse_descriptor(descriptor)
        except DescriptorError as error:
            raise DriverError(f"its report descriptor cannot be read: {error}") from error
        config = config or PidConfig()
        self._inputs, self._actuators = InputReportDecoder(parsed), ActuatorReports(parsed)
        self._actuators_begun = ActuatorState()
        self._layout = layout = build_layout(parsed, self._inputs)
        self._on = _build_control_reports(
            layout.control,
            U.DEVICE_RESET,
            U.STOP_ALL_EFFECTS,  # SideWinder firmware centres from a reset until this
            U.DEVICE_CONTINUE,
            U.ENABLE_ACTUATORS,
        )
        self._off = _build_control_reports(layout.control, U.STOP_ALL_EFFECTS, U.DISABLE_ACTUATORS)
        conditions = {U.SPRING: config.spring, U.DAMPER: config.damper}
        self._conditions = {usage: share for usage, share in conditions.items() if share}
        # detect errors now, not while the device is in use
        for usage in (U.CONSTANT_FORCE, *self._conditions):
            layout.creation.choose(usage)
            build_effect_report(layout, usage, 1, layout.forces[0])
        for share in self._conditions.values():
            build_condition_reports(layout, 1, share)
        self._magnitude = layout.constant_force.get_field(U.MAGNITUDE)
        self.axes = self._inputs.axes
        self.forces = layout.forces if pushed is None else _select_axes(layout.forces, pushed)
        self.buttons = self._inputs.buttons
        self._forget()

    def begin(self, device: ReportAccess) -> None:
        """Reset the device, enable it, and make the effects, none of them started.

        Firmware of the SideWinder family starts a centring spring at a reset, which only Stop All
        Effects ends (tloimu/adapt-ffb-joy, ffb-pro.c). OpenFFBoard is off after that until it is
        enabled. With the Arduino library a reset does not end an earlier pause, and reading the
        pool frees all effects.
        """
        self._forget()
        for report in self._on:
            device.write(report)
        part = self._layout.gain
        if part is not None and (gain := part.find(U.GAIN)) is not None:
            device.write(part.pack([FieldValue(gain, compute_limits(gain)[1])]))
        for axis in self.forces:
            self._add_force(device, axis)
        for usage, share in self._conditions.items() if self.forces else ():
            self._add_condition(device, usage, share)
        self._actuators_begun = self._actuators.ask(device)

    def decode(self, controls: Controls, report: bytes) -> Controls:
        """Return `controls` updated with `report`."""
        actuators_before = controls.actuators
        actuators = self._actuators.decode(
            self._actuators_begun if actuators_before is None else actuators_before, report
        )
        if actuators is not actuators_before:
            controls = controls._replace(actuators=actuators)
        return self._inputs.decode(controls, report)

    def encode(self, force: tuple[Share, ...], arm: bool) -> tuple[bytes, ...]:
        """Return one magnitude for each of `forces`, and with `arm` a start for each effect.

        Spring and damper run only while a force is requested, that is not before engagement, at a
        fault or at a stop. Returns nothing before `begin`.
        """
        offset, mask = self._magnitude.offset, (1 << self._magnitude.size) - 1
        reports = [
            (bits | (scale_share(share, full) & mask) << offset).to_bytes(len(zero), "little")
            for (zero, bits, full), share in zip(self._pushes, force, strict=False)
        ]
        conditions = self._effects[len(self.forces) :]
        if not any(abs(share) > 0.0 for share in force):
            reports += [effect.stop for effect in conditions]
        elif arm:
            reports += [effect.start for effect in conditions]
        if arm:
            reports += [effect.start for effect in self._effects[: len(self.forces)]]
        return tuple(reports)

    def silence(self) -> tuple[bytes, ...]:
        """Return zero magnitudes, a stop for each effect, and a stop for the device.

        All of them, as each firmware ignores some.
        """
        zeros = [push.zero for push in self._pushes]
        stops = [effect.stop for effect in self._effects]
        part = self._layout.block_free
        frees = [_build_block_report(part, effect.block) for effect in self._effects if part]
        return (*zeros, *stops, *frees, *self._off)

    def _forget(self) -> None:
        self._effects: list[_Effect] = []  # those of `forces`, then spring and damper
        self._pushes: list[_ConstantForce] = []

    def _create(self, device: ReportAccess, usage: int) -> int:
        ours = [effect.block for effect in self._effects]
        block = create_effect(self._layout, device, usage, ours)
        start = build_start_report(self._layout, block)
        self._effects.append(_Effect(block, start, build_stop_report(self._layout, block)))
        return block

    def _add_force(self, device: ReportAccess, axis: str) -> None:
        block = self._create(device, U.CONSTANT_FORCE)
        zero = build_zero_force_report(self._layout, block)
        device.write(build_effect_report(self._layout, U.CONSTANT_FORCE, block, axis))
        device.write(zero)
        low, high = compute_limits(self._magnitude)
        full = _SIGNS[axis] * min(-low, high)
        self._pushes.append(_ConstantForce(zero, int.from_bytes(zero, "little"), full))

    def _add_condition(self, device: ReportAccess, usage: int, share: Share) -> None:
        """Make a spring or a damper on all axes, each with its own parameters.

        OpenFFBoard rotates a condition by the direction of its effect (a spring along y then pushes
        away) unless the parameters come first; other firmware needs the effect first.
        """
        block = self._create(device, usage)
        effect = build_effect_report(self._layout, usage, block, self._layout.forces[0])
        device.write(effect)
        for report in build_condition_reports(self._layout, block, share):
            device.write(report)
        device.write(effect)


def _select_axes(forces: tuple[str, ...], pushed: tuple[str, ...]) -> tuple[str, ...]:
    if lacking := [axis for axis in pushed if axis not in forces]:
        raise DriverError(f"it cannot push {', '.join(lacking)}, only {', '.join(forces)}")
    return tuple(axis for axis in forces if axis in pushed)


def _build_control_reports(control: ReportPart, *usages: int) -> tuple[bytes, ...]:
    """Return a Device Control report for each of `usages` that the device knows."""
    supported = [usage for usage in usages if control.find(usage) is not None]
    return tuple(control.pack([control.choose(usage)]) for usage in supported)


# --- effects in the memory of a device: create, set, start and free

DURATION_S = 0.2  # [s] of every effect; must be restarted well within
_SECONDS = (0x1001, 0x1003)  # unit codes
_LOAD_READS = 60  # hid-pidff of Linux asks as often


def create_effect(layout: PidLayout, device: ReportAccess, usage: int, ours: Container[int]) -> int:
    """Return the number of a new effect; `DriverError` if the device has none free.

    If its memory is full, effects of earlier programs are freed: all numbers except `ours`.
    """
    report = layout.creation.pack([layout.creation.choose(usage)])
    device.send_feature(report)
    block, full, answer = _read_block_load(layout.block_load, device)
    if full and layout.block_free is not None:
        low, high = compute_limits(layout.block_free.get_field(U.BLOCK_INDEX))
        for number in range(max(low, 1), min(high, 255) + 1):
            if number not in ours:
                device.write(_build_block_report(layout.block_free, number))
        device.send_feature(report)
        block, full, answer = _read_block_load(layout.block_load, device)
    if full:
        raise DriverError("its memory for effects is full")
    if not block:
        raise DriverError(
            f"it did not create the effect ({U.format_usage(usage)}); it answers "
            f"{answer.hex(' ') or 'nothing'} to Block Load (report {layout.block_load.number}): "
            "switch it off and on; if that does not help, run `teleop devices dump` for a report"
        )
    return block


def _read_block_load(part: ReportPart, device: ReportAccess) -> tuple[int, bool, bytes]:
    """Return the number of the effect just made, 0 = none, whether memory is full, and the answer.

    The first valid answer is used: some firmware clears it on reading.
    """
    status, index = part.get_field(U.LOAD_SUCCESS), part.get_field(U.BLOCK_INDEX)
    success = part.choose(U.LOAD_SUCCESS).value
    full = part.choose(U.LOAD_FULL).value if part.find(U.LOAD_FULL) else None
    reply = b""
    for _ in range(_LOAD_READS):
        reply = device.get_feature(part.number, part.length)
        if len(reply) < part.length or reply[0] != part.number:
            continue
        load_status, block = read_field(reply, status), read_field(reply, index)
        if load_status == success and block > 0:
            return block, False, reply
        if load_status == full:
            return 0, True, reply
    return 0, False, reply


def build_effect_report(layout: PidLayout, usage: int, block: int, axis: str) -> bytes:
    """Return Set Effect: `DURATION_S`, full gain, no delay, no trigger button, along `axis`.

    No axis may be enabled with the direction: the Arduino library uses the angle only then.
    """
    part = layout.set_effect
    duration = part.get_field(U.DURATION)
    choices = [part.choose(usage), FieldValue(duration, compute_duration_ticks(duration))]
    gain = part.find(U.EFFECT_GAIN)
    if gain is not None:
        choices.append(FieldValue(gain, compute_limits(gain)[1]))
    if layout.polar:
        choices.append(part.choose(U.DIRECTION_ENABLE))
    else:
        enable = [f for f in part.list_fields_within(U.AXES_ENABLE) if U.AXES.get(f.usage) == axis]
        choices += [FieldValue(field, 1) for field in enable]
    directions = part.list_fields_within(U.DIRECTION)
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
        FieldValue(field, scale_share(share, compute_limits(field)[1]))
        for usage in _CONDITION_USAGES
        if (field := part.find(usage)) is not None
    ]
    if not choices:
        raise DriverError(f"{part.name} has no {U.format_usage(U.POSITIVE_COEFFICIENT)}")
    if layout.forces == ("x",) and part.find(U.PARAMETER_BLOCK_OFFSET) is None:
        return (_build_block_report(part, block, *choices),)
    offset = part.get_field(U.PARAMETER_BLOCK_OFFSET)
    numbers = [list(FORCE_AXES).index(axis) for axis in layout.forces]
    return tuple(
        _build_block_report(part, block, FieldValue(offset, number), *choices) for number in numbers
    )


_CONDITION_USAGES = (
    *(U.POSITIVE_COEFFICIENT, U.NEGATIVE_COEFFICIENT),
    *(U.POSITIVE_SATURATION, U.NEGATIVE_SATURATION),
)


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


def _build_block_report(part: ReportPart, block: int, *choices: FieldValue) -> bytes:
    return part.pack([FieldValue(part.get_field(U.BLOCK_INDEX), block), *choices])
