"""A HID haptic device with the interface of `master.device.Device`."""

import math
from collections.abc import Callable

from master.device import Axes, DeviceFault, DeviceLost, HandState
from master.devices.hid import console_mode, mapping, search, signs
from master.devices.hid.claims import CLAIMS
from master.devices.hid.config import HidConfig
from master.devices.hid.drivers import INPUTS_ONLY, PID, AttachedNode
from master.devices.hid.line import DeviceConnection
from master.devices.hid.pid import PidConfig, PidDriver
from master.devices.hid.search import FoundDevice
from master.devices.hid.seeker import DeviceReconnection
from master.devices.hid.signs import ForceSigns

_PATIENCE_S = 2.0  # to remove the force at the end; a write may hang for 5 s


class OpenedDevice:
    """The open device, the one with its buttons (mostly the same), and the mapping."""

    def __init__(
        self, config: HidConfig, known: ForceSigns, found: tuple[FoundDevice, ...]
    ) -> None:
        self.lines: list[DeviceConnection] = []
        pid = config.pid if may_use_device_effects(found[0], known) else PidConfig()
        pushed = tuple(axis.name for axis in config.axes if axis.force > 0.0)
        CLAIMS.claim(found[0].item)
        self._claimed: AttachedNode | None = found[0].item
        try:
            for one in found:
                self.lines.append(DeviceConnection(one, pid, pushed))
            self.device, self.switches = self.lines[0], self.lines[-1]
            buttons = self.switches.driver.buttons
            found_signs = known.of(found[0].pusher)
            self.plan = mapping.build_mapping(config, self.device.driver, buttons, found_signs)
        except BaseException:
            self.end()
            raise

    def end(self, patience_s: float = 0.0) -> bool:
        """Remove the force and close; return whether that was done in time."""
        ended = [line.end(patience_s) for line in self.lines]
        if self._claimed is not None:  # once: it may be in use again by the next call
            CLAIMS.release(self._claimed)
            self._claimed = None
        return all(ended)


class HidDevice:
    """A `master.device.Device`; see docs/devices.md.

    An unplugged device is searched for until it is back; meanwhile `read` raises `DeviceLost`. Its
    force is then zero until the next `write` after a successful read.

    Parameters
    ----------
    say : callable
        Called with one line about the device and with each warning.
    """

    def __init__(self, config: HidConfig, say: Callable[[str], None] = print) -> None:
        self._config = config
        if switched := console_mode.leave_console_mode(config.find, config.driver):
            say(switched)
        self._found: tuple[FoundDevice, ...] = (search.find_device(config.find, config.driver),)
        if config.buttons.find:
            self._found += (search.find_device(config.buttons.find, INPUTS_ONLY),)
        self._signs = signs.load(config.signs)
        advice = search.examine_node(self._found[0].item).advice
        if advice and any(axis.force > 0.0 for axis in config.axes):
            raise DeviceFault(f"{self._found[0].item}: {advice}")
        opened = OpenedDevice(config, self._signs, self._found)
        self.axes = opened.plan.joints
        self._opened: OpenedDevice | None = opened
        self._seeker: DeviceReconnection[OpenedDevice] | None = None
        self._lost = ""
        self._memory = mapping.init_mapping(self.axes)
        self._time_s = 0.0
        for line in describe_device(config, self._found, self._signs):
            say(line)
        if advice:
            say(f"WARNING: {advice}")

    def read(self, time_s: float) -> HandState:
        """Return the newest hand state.

        `DeviceLost` while the device is unplugged or reports that it cannot render a force, and
        once after lost reports, which may have contained a button change.
        """
        dt, self._time_s = time_s - self._time_s, time_s
        opened = self._opened or self._returned()
        try:
            controls = opened.device.read(time_s)
            switches = controls
            if opened.switches is not opened.device:
                switches = opened.switches.read(time_s)
        except DeviceFault as fault:
            raise self._lose(opened, fault) from fault
        knew = self._memory.knows
        hand, self._memory = mapping.step(
            opened.plan, self._memory, controls, switches, max(dt, 0.0)
        )
        if knew and not self._memory.knows:
            raise DeviceLost("reports were lost: they were not read in time")
        if controls.actuators is not None and (faults := controls.actuators.faults):
            raise DeviceLost(f"{opened.device.found.item}: {'; '.join(faults)}")
        return hand

    def write(self, force: Axes) -> None:
        """Render `force` [N] until the next write; no effect while the device is unplugged."""
        if len(force) != self.axes or not all(map(math.isfinite, force)):
            raise DeviceFault(f"refuses force {force}")
        if self._opened is not None:
            self._opened.device.post(mapping.to_force_shares(self._opened.plan, force))

    def close(self) -> None:
        """Remove the force and close; does not wait for a hanging device."""
        opened, self._opened = self._opened, None
        if opened is not None:
            opened.end(_PATIENCE_S)
        if self._seeker is not None:
            self._seeker.end(_PATIENCE_S)

    def _lose(self, opened: OpenedDevice, fault: DeviceFault) -> DeviceLost:
        self._opened = None
        self._memory = mapping.init_mapping(self.axes)._replace(position=self._memory.position)
        self._lost = f"{fault}; waiting for the device"
        before = search.list_node_paths(self._found[0]) | search.list_node_paths(self._found[-1])
        self._seeker = DeviceReconnection(opened, lambda: self._open_again(before))
        return DeviceLost(self._lost)

    def _open_again(self, before: frozenset[str]) -> OpenedDevice:
        device, *switches = self._found
        back = [console_mode.find_reattached_device(device, before, CLAIMS.paths())]
        if CLAIMS.is_ambiguous(device.item):
            raise DeviceFault(
                f"{device.item}: was unplugged together with a device of the same identity, which "
                "cannot be distinguished; restart the master"
            )
        back += [search.find_reattached_device(one, before) for one in switches]
        return OpenedDevice(self._config, self._signs, tuple(back))

    def _returned(self) -> OpenedDevice:
        assert self._seeker is not None  # noqa: S101 - set when the device was lost
        if self._seeker.found is None:
            raise DeviceLost(self._seeker.trouble or self._lost)
        self._opened, self._seeker = self._seeker.found, None
        return self._opened


def may_use_device_effects(found: FoundDevice, known: ForceSigns) -> bool:
    """Return whether a device's own effects may be used: all its signs are +1.

    A sign of -1 means either a reversed motor, whose own spring would push away from the centre, or
    another convention; these cannot be distinguished.
    """
    signs_found = known.of(found.pusher)
    return found.kind == PID and all(
        signs_found.get(axis) == 1 for axis in PidDriver(found.descriptor).forces
    )


def describe_device(
    config: HidConfig, found: tuple[FoundDevice, ...], known: ForceSigns
) -> list[str]:
    """Return the messages to the operator about a newly opened device."""
    lines = [f"device: {found[0].item}, driver {found[0].kind}"]
    lines += [f"buttons: {one.item}, driver {one.kind}" for one in found[1:]]
    names = mapping.find_unsigned_axes(config, known.of(found[0].pusher))
    if names:
        lines.append(
            f"WARNING: no force on {', '.join(names)}: force sign unknown; run `teleop devices "
            "test`"
        )
    if config.pid != PidConfig() and not may_use_device_effects(found[0], known):
        lines.append(
            "WARNING: pid.spring and pid.damper are off: they could push away from the centre, "
            "as `teleop devices test` has not found a sign of +1 for each axis"
        )
    return lines
