"""Several devices as one: two hands, or an arm and a gripper.

Their axes are concatenated: those of the first device are the first joints. Each device may have
scales of its own, of motion and of force, besides those of the operator: a gripper beside an arm.
The loop applies those of force to what the tips feel, not to walls, fixtures and weight.
The devices are read in the same call, microseconds apart. All engage switches must be held;
releasing any one disengages. A clutch, an emergency stop or any other button of one device applies
to all. A fault of one device is a fault of all.
"""

from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from typing import Literal

from master.device import Axes, Device, DeviceFault, DeviceLost, HandState, require_force
from master.devices.extension import DeviceExtension
from master.devices.hid.input_map import HidConfig
from master.devices.ros_device import RosDeviceConfig
from master.devices.virtual import VirtualConfig
from teleop.config.ranges import build_ranged_field, check_ranges
from teleop.messages.messages import MAX_JOINTS

# --- the configs of single haptic devices

# all of them, joined by `|`; the key `type` in a config chooses
SingleConfig = VirtualConfig | HidConfig | RosDeviceConfig | DeviceExtension


@dataclass(frozen=True, slots=True)
class CombinedConfig:
    """Several devices in one session."""

    type: Literal["combined"] = "combined"
    devices: tuple[SingleConfig, ...] = (VirtualConfig(), VirtualConfig())  # in order of joints
    # of each device: motion of the hand over its own; empty = 1
    position_scales: tuple[float, ...] = build_ranged_field((), 0.0, 10.0, above=True)
    # ... and the force of the tips on it over that on the hand, at most 1
    force_scales: tuple[float, ...] = build_ranged_field((), 0.0, 1.0, above=True)

    def __post_init__(self) -> None:
        if len(self.devices) < 2:
            raise ValueError(
                "devices: at least 2 are needed; configure a single device without `combined`"
            )
        if self.axis_count > MAX_JOINTS:
            each = " + ".join(str(device.axis_count) for device in self.devices)
            raise ValueError(f"devices: {each} axes, must be at most {MAX_JOINTS} together")
        check_ranges(self)
        for name in ("position_scales", "force_scales"):
            if len(getattr(self, name)) not in (0, len(self.devices)):
                raise ValueError(f"{name}: must have {len(self.devices)} numbers, one a device")

    @property
    def axis_count(self) -> int:
        """How many joints they move."""
        return sum(device.axis_count for device in self.devices)

    def list_force_scales(self) -> list[float]:
        """Return the force scale of each axis."""
        scales = self.force_scales or (1.0,) * len(self.devices)
        parts = zip(self.devices, scales, strict=True)
        return [scale for device, scale in parts for _ in range(device.axis_count)]


class CombinedDevice:
    """A `master.device.Device` made of several.

    `open_single` opens one. If it fails, those opened before are closed. `DeviceFault` if one of
    them cannot be opened, or has no axes or more than there is room for.
    """

    def __init__(
        self, config: CombinedConfig, open_single: Callable[[SingleConfig], Device]
    ) -> None:
        self._devices: list[Device] = []
        self._parts: list[slice] = []  # of the axes, one for each device
        self.axes = 0
        with ExitStack() as opened:
            for number, part in enumerate(config.devices):
                try:
                    device = open_single(part)
                except DeviceFault as fault:
                    raise _add_index(number, fault) from fault
                opened.callback(device.close)
                room = MAX_JOINTS - self.axes
                if not 1 <= device.axes <= room:
                    raise DeviceFault(
                        f"devices.{number}: {part.type} has {device.axes} axes, must be 1 to {room}"
                    )
                self._devices.append(device)
                self._parts.append(slice(self.axes, self.axes + device.axes))
                self.axes += device.axes
            self._opened = opened.pop_all()
        self._released = [False] * len(self._devices)
        self._position_scales = config.position_scales or (1.0,) * len(self._devices)

    def read(self, time_s: float) -> HandState:
        """Return all hands as one.

        Engage is the logical AND. At the start, and again after a device was lost, it counts as
        held until every switch has been open, so no device is engaged without being released first.

        `DeviceFault` if one of them has failed, `DeviceLost` only if all failures are recoverable.
        The other devices are still read, so that each of them can come back.
        """
        hands: list[HandState] = []
        faults: list[DeviceFault] = []
        for number, device in enumerate(self._devices):
            try:
                hands.append(device.read(time_s))
            except DeviceFault as fault:
                faults.append(_add_index(number, fault))
        if faults:
            self._released = [False] * len(self._devices)
            raise _combine_faults(faults)
        engage = self._engage([hand.engage for hand in hands])
        scaled = tuple(zip(hands, self._position_scales, strict=True))
        return HandState(
            tuple(scale * x for hand, scale in scaled for x in hand.position),
            tuple(scale * v for hand, scale in scaled for v in hand.velocity),
            engage,
            any(hand.clutch for hand in hands),
            any(hand.stop for hand in hands),
            any(hand.finer for hand in hands),
            any(hand.coarser for hand in hands),
            any(hand.weaker for hand in hands),
            any(hand.stronger for hand in hands),
            tuple(number for hand in hands for number in hand.buttons),
        )

    def write(self, force: Axes) -> None:
        """Write each device its part of `force` [N]; if one fails, the others get zero."""
        require_force(force, self.axes)
        faults: list[DeviceFault] = []
        for number, (device, part) in enumerate(zip(self._devices, self._parts, strict=True)):
            try:
                device.write(force[part])
            except DeviceFault as fault:
                faults.append(_add_index(number, fault))
        if faults:
            for device in self._devices:
                with suppress(DeviceFault):
                    device.write((0.0,) * device.axes)
            raise _combine_faults(faults)

    def close(self) -> None:
        """Close all in reverse order, also if one fails."""
        self._opened.close()

    def _engage(self, engage_inputs: list[bool]) -> bool:
        if all(self._released):
            return all(engage_inputs)
        self._released = [
            before or not now for before, now in zip(self._released, engage_inputs, strict=True)
        ]
        return any(engage_inputs)


def _add_index(number: int, fault: DeviceFault) -> DeviceFault:
    """Return a fault of the same type with the device's index in front of the message."""
    kind = DeviceLost if isinstance(fault, DeviceLost) else DeviceFault
    return kind(f"devices.{number}: {fault}")


def _combine_faults(faults: list[DeviceFault]) -> DeviceFault:
    """Return one fault for several: `DeviceLost` only if all are."""
    final = [fault for fault in faults if not isinstance(fault, DeviceLost)]
    if final:
        return DeviceFault("; ".join(map(str, final)))
    return DeviceLost("; ".join(map(str, faults)))
