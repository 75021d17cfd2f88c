"""Any force-feedback device of the USB PID class, driven by its report descriptor.

One constant-force effect for each axis, made once and updated by its magnitude. Its duration is
finite and short: the force ends if the host does not restart it. A spring and a damper can be
rendered by the device, whose loop is faster than ours.
"""

from dataclasses import dataclass
from typing import NamedTuple

from master.devices.hid import pid_reports
from master.devices.hid import usages as U  # noqa: N812
from master.devices.hid.descriptor import (
    DescriptorError,
    compute_limits,
    parse_descriptor,
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
from master.devices.hid.pid_reports import FieldValue, ReportPart, build_layout
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


class _ConstantForce(NamedTuple):
    """A constant force in the device's memory."""

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
            pid_reports.build_effect_report(layout, usage, 1, layout.forces[0])
        for share in self._conditions.values():
            pid_reports.build_condition_reports(layout, 1, share)
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
        if self._conditions and not any(abs(share) > 0.0 for share in force):
            reports += self._condition_stops
        elif self._conditions and arm:
            reports += self._condition_starts
        return (*reports, *self._starts) if arm else tuple(reports)

    def silence(self) -> tuple[bytes, ...]:
        """Return zero magnitudes, a stop for each effect, and a stop for the device.

        All of them, as each firmware ignores some.
        """
        zeros = [push.zero for push in self._pushes]
        return (*zeros, *self._stops, *self._condition_stops, *self._frees, *self._off)

    def _forget(self) -> None:
        self._blocks: list[int] = []
        self._pushes: list[_ConstantForce] = []
        self._starts: list[bytes] = []
        self._stops: list[bytes] = []
        self._condition_starts: list[bytes] = []
        self._condition_stops: list[bytes] = []
        self._frees: list[bytes] = []

    def _create(self, device: ReportAccess, usage: int) -> int:
        block = pid_reports.create_effect(self._layout, device, usage, self._blocks)
        self._blocks.append(block)
        self._frees += pid_reports.build_free_reports(self._layout, block)
        return block

    def _add_force(self, device: ReportAccess, axis: str) -> None:
        block = self._create(device, U.CONSTANT_FORCE)
        self._starts.append(pid_reports.build_start_report(self._layout, block))
        self._stops.append(pid_reports.build_stop_report(self._layout, block))
        zero = pid_reports.build_zero_force_report(self._layout, block)
        device.write(pid_reports.build_effect_report(self._layout, U.CONSTANT_FORCE, block, axis))
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
        self._condition_starts.append(pid_reports.build_start_report(self._layout, block))
        self._condition_stops.append(pid_reports.build_stop_report(self._layout, block))
        effect = pid_reports.build_effect_report(self._layout, usage, block, self._layout.forces[0])
        device.write(effect)
        for report in pid_reports.build_condition_reports(self._layout, block, share):
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
