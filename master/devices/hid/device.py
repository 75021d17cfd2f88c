"""A HID haptic device with the interface of `master.device.Device`."""

import os
import threading
from collections import Counter
from collections.abc import Callable
from typing import NamedTuple

from master.device import Axes, DeviceFault, DeviceLost, HandState, require_force
from master.devices.hid import force_signs, input_map, search
from master.devices.hid.connection import DeviceConnection
from master.devices.hid.driver_table import INPUTS_ONLY, PID, AttachedNode
from master.devices.hid.force_signs import ForceSigns
from master.devices.hid.input_map import HidConfig
from master.devices.hid.pid import PidConfig, PidDriver
from master.devices.hid.search import DeviceNotFoundError, FoundDevice

# --- registry of the nodes open in this process, so that no device is opened twice


# system and inode of a device file; not its times, as a change of permissions changes them
_FileIdentity = tuple[int, int]


class _Claim(NamedTuple):
    """An open device."""

    identity: str
    file: _FileIdentity | None  # None on systems without device files


class Claims:
    """The open devices; thread-safe.

    A device with buttons alone (`buttons.find`) is not claimed: one pedal may serve two hands.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._open: dict[str, _Claim] = {}  # by path
        self._most: Counter[str] = Counter()  # of each identity, largest number open at once

    def claim(self, item: AttachedNode) -> None:
        """Claim a device; `DeviceFault` if it is in use."""
        with self._lock:
            if item.path in self._open:
                raise DeviceFault(
                    f"{item}: already in use by another device of this session; set find to a "
                    "serial number or path"
                )
            self._open[item.path] = _Claim(item.identity, _identify_file(item.path))
            claims = sum(claim.identity == item.identity for claim in self._open.values())
            self._most[item.identity] = max(self._most[item.identity], claims)

    def release(self, item: AttachedNode) -> None:
        """Release a device."""
        with self._lock:
            self._open.pop(item.path, None)

    def forget(self) -> None:
        """Reset, as in a new process."""
        with self._lock:
            self._open.clear()
            self._most.clear()

    def list_paths(self) -> frozenset[str]:
        """Return the paths of the claimed devices."""
        with self._lock:
            return frozenset(self._open)

    def is_ambiguous(self, item: AttachedNode) -> bool:
        """Return whether a device that came back may be any of several that were unplugged.

        Two devices open at once with the same identity (no serial number, or the same one) differ
        only in their paths. If both were unplugged, each may come back at the other's path. An open
        device whose file is gone is unplugged, even if that was not noticed yet.
        """
        with self._lock:
            here = sum(
                claim.identity == item.identity and claim.file == _identify_file(path)
                for path, claim in self._open.items()
            )
            return self._most[item.identity] - here > 1


def _identify_file(path: str) -> _FileIdentity | None:
    try:
        status = os.stat(path)
    except OSError:
        return None
    return status.st_dev, status.st_ino


CLAIMS = Claims()  # of this process


# --- thread that searches for an unplugged device

POLL_PERIOD_S = 0.1  # between two looks
# consecutive failures before they are reported; a device is not usable at once
_FAILURES_REPORTED = 20


class DeviceReconnection:
    """Closes the failed device, then tries `open_again` until it succeeds.

    The failed device is closed completely first, so that its last report does not reach the next
    one, which is `found` once available. `trouble` tells why an attached device cannot be opened;
    it is empty while that may only need time.
    """

    def __init__(self, broken: "OpenedDevice", open_again: Callable[[], "OpenedDevice"]) -> None:
        self.found: OpenedDevice | None = None
        self.trouble = ""
        self._broken, self._open = broken, open_again
        self._lock, self._over = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="hid seeker", daemon=True)
        self._thread.start()

    def end(self, patience_s: float) -> None:
        """Stop searching, and close a device found but not taken."""
        with self._lock:
            self._over.set()
        self._thread.join(patience_s)
        if self.found is not None:
            self.found.end(patience_s)

    def _run(self) -> None:
        failures = 0
        while not self._over.is_set():
            try:
                if self._broken.end(POLL_PERIOD_S):
                    self._keep(self._open())
                    return
            except DeviceNotFoundError:
                failures, self.trouble = 0, ""
            except Exception as error:
                failures += 1
                if failures == _FAILURES_REPORTED:
                    expected = isinstance(error, DeviceFault)
                    self.trouble = str(error) if expected else f"search failed: {error!r}"
            self._over.wait(POLL_PERIOD_S)

    def _keep(self, device: "OpenedDevice") -> None:
        with self._lock:
            if not self._over.is_set():
                self.found = device
                return
        device.end()


_PATIENCE_S = 2.0  # to remove the force at the end; a write may hang for 5 s


class OpenedDevice:
    """The open device, the one with its buttons (mostly the same), and the mapping."""

    def __init__(
        self, config: HidConfig, force_signs: ForceSigns, devices: tuple[FoundDevice, ...]
    ) -> None:
        self.lines: list[DeviceConnection] = []
        pid = config.pid if may_use_device_effects(devices[0], force_signs) else PidConfig()
        pushed = tuple(axis.name for axis in config.axes if axis.force > 0.0)
        CLAIMS.claim(devices[0].item)
        self._claimed: AttachedNode | None = devices[0].item
        try:
            for device in devices:
                self.lines.append(DeviceConnection(device, pid, pushed))
            self.device, self.switches = self.lines[0], self.lines[-1]
            buttons = self.switches.driver.buttons
            found_signs = force_signs.find_signs(devices[0].pusher)
            self.plan = input_map.build_input_map(config, self.device.driver, buttons, found_signs)
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
    """A `master.device.Device`; see docs/how-to/haptic-device.md.

    An unplugged device is searched for until it is back; meanwhile `read` raises `DeviceLost`. Its
    force is then zero until the next `write` after a successful read. `say` is called with one line
    about the device and with each warning.
    """

    def __init__(self, config: HidConfig, say: Callable[[str], None] = print) -> None:
        self._config = config
        if switched := search.leave_console_mode(config.find, config.driver):
            say(switched)
        self._found: tuple[FoundDevice, ...] = (search.find_device(config.find, config.driver),)
        if config.buttons.find:
            self._found += (search.find_device(config.buttons.find, INPUTS_ONLY),)
        self._signs = force_signs.load(config.signs)
        advice = search.examine_node(self._found[0].item).advice
        if advice and any(axis.force > 0.0 for axis in config.axes):
            raise DeviceFault(f"{self._found[0].item}: {advice}")
        warnings = [
            text for device in self._found if (text := search.find_other_users(device.item))
        ]
        opened = OpenedDevice(config, self._signs, self._found)
        self.axes = opened.plan.joints
        self._opened: OpenedDevice | None = opened
        self._seeker: DeviceReconnection | None = None
        self._lost = ""
        self._memory = input_map.init_input_map(self.axes)
        self._time_s = 0.0
        for line in describe_device(config, self._found, self._signs):
            say(line)
        for text in (*warnings, *([advice] if advice else [])):
            say(f"WARNING: {text}")

    def read(self, time_s: float) -> HandState:
        """Return the newest hand state.

        `DeviceLost` while the device is unplugged or reports that it cannot render a force, and
        once after lost reports, which may have contained a button change.
        """
        dt, self._time_s = time_s - self._time_s, time_s
        opened = self._opened or self._get_reopened()
        try:
            controls = opened.device.read(time_s)
            switches = controls
            if opened.switches is not opened.device:
                switches = opened.switches.read(time_s)
        except DeviceFault as fault:
            raise self._lose(opened, fault) from fault
        knew = self._memory.knows
        hand, self._memory = input_map.step(
            opened.plan, self._memory, controls, switches, max(dt, 0.0)
        )
        if knew and not self._memory.knows:
            raise DeviceLost("reports were lost: they were not read in time")
        if controls.actuators is not None and (faults := controls.actuators.faults):
            raise DeviceLost(f"{opened.device.found.item}: {'; '.join(faults)}")
        return hand

    def write(self, force: Axes) -> None:
        """Render `force` [N] until the next write; no effect while the device is unplugged."""
        require_force(force, self.axes)
        if self._opened is not None:
            self._opened.device.post(input_map.to_force_shares(self._opened.plan, force))

    def close(self) -> None:
        """Remove the force and close; does not wait for a hanging device."""
        opened, self._opened = self._opened, None
        if opened is not None:
            opened.end(_PATIENCE_S)
        if self._seeker is not None:
            self._seeker.end(_PATIENCE_S)

    def _lose(self, opened: OpenedDevice, fault: DeviceFault) -> DeviceLost:
        self._opened = None
        self._memory = input_map.init_input_map(self.axes)._replace(position=self._memory.position)
        self._lost = f"{fault}; waiting for the device"
        paths_before = search.list_node_paths(self._found[0]) | search.list_node_paths(
            self._found[-1]
        )
        self._seeker = DeviceReconnection(opened, lambda: self._open_again(paths_before))
        return DeviceLost(self._lost)

    def _open_again(self, paths_before: frozenset[str]) -> OpenedDevice:
        device, *switches = self._found
        reattached = [search.reattach_device(device, paths_before, CLAIMS.list_paths())]
        if CLAIMS.is_ambiguous(device.item):
            raise DeviceFault(
                f"{device.item}: was unplugged together with a device of the same identity, which "
                "cannot be distinguished; restart the master"
            )
        reattached += [search.find_reattached_device(switch, paths_before) for switch in switches]
        return OpenedDevice(self._config, self._signs, tuple(reattached))

    def _get_reopened(self) -> OpenedDevice:
        assert self._seeker is not None  # noqa: S101 - set when the device was lost
        if self._seeker.found is None:
            raise DeviceLost(self._seeker.trouble or self._lost)
        self._opened, self._seeker = self._seeker.found, None
        return self._opened


def may_use_device_effects(device: FoundDevice, force_signs: ForceSigns) -> bool:
    """Return whether a device's own effects may be used: all its signs are +1.

    A sign of -1 means either a reversed motor, whose own spring would push away from the centre, or
    another convention; these cannot be distinguished.
    """
    signs_found = force_signs.find_signs(device.pusher)
    return device.kind == PID and all(
        signs_found.get(axis) == 1 for axis in PidDriver(device.descriptor).forces
    )


def describe_device(
    config: HidConfig, devices: tuple[FoundDevice, ...], force_signs: ForceSigns
) -> list[str]:
    """Return the messages to the operator about a newly opened device."""
    lines = [f"device: {devices[0].item}, driver {devices[0].kind}"]
    lines += [f"buttons: {device.item}, driver {device.kind}" for device in devices[1:]]
    names = input_map.find_unsigned_axes(config, force_signs.find_signs(devices[0].pusher))
    if names:
        lines.append(
            f"WARNING: no force on {', '.join(names)}: force sign unknown; run `teleop devices "
            "test`"
        )
    if config.pid != PidConfig() and not may_use_device_effects(devices[0], force_signs):
        lines.append(
            "WARNING: pid.spring and pid.damper are off: they could push away from the centre, "
            "as `teleop devices test` has not found a sign of +1 for each axis"
        )
    return lines
