"""A haptic device that speaks HID, as the master loop sees it."""

import math
from collections.abc import Callable

from master.device import Axes, DeviceFault, DeviceLost, HandState
from master.devices.hid import mapping, search, signs
from master.devices.hid.claims import CLAIMS
from master.devices.hid.config import HidConfig
from master.devices.hid.drivers import INPUTS_ONLY, PID, AttachedNode
from master.devices.hid.line import DeviceConnection
from master.devices.hid.pid import PidConfig, PidDriver
from master.devices.hid.search import FoundDevice
from master.devices.hid.seeker import Seeker
from master.devices.hid.signs import Signs

_PATIENCE_S = 2.0  # for taking the force away at the end; a write may hang for 5 s


class OpenedDevice:
    """The device, the one with its buttons (mostly the same), and the way to the hand."""

    def __init__(self, config: HidConfig, known: Signs, found: tuple[FoundDevice, ...]) -> None:
        self.lines: list[DeviceConnection] = []
        pid = config.pid if trusted(found[0], known) else PidConfig()
        CLAIMS.claim(found[0].item)
        self._claimed: AttachedNode | None = found[0].item
        try:
            for one in found:
                self.lines.append(DeviceConnection(one, pid))
            self.device, self.switches = self.lines[0], self.lines[-1]
            buttons = self.switches.driver.buttons
            found_signs = known.of(found[0].pusher)
            self.plan = mapping.plan(config, self.device.driver, buttons, found_signs)
        except BaseException:
            self.end()
            raise

    def end(self, patience_s: float = 0.0) -> bool:
        """Take the force away and close; return whether that was done in time."""
        ended = [line.end(patience_s) for line in self.lines]
        if self._claimed is not None:  # once: another hand may have it by the next call
            CLAIMS.release(self._claimed)
            self._claimed = None
        return all(ended)


class HidDevice:
    """A `master.device.Device`; see docs/devices.md.

    A device that is unplugged is looked for until it is back; meanwhile `read` raises `DeviceLost`.
    Its force is zero from then on until the next `write` after it was read again.

    Parameters
    ----------
    say : callable
        Told, in one line each, which device it is and what will not be felt.
    """

    def __init__(self, config: HidConfig, say: Callable[[str], None] = print) -> None:
        self._config = config
        self._found: tuple[FoundDevice, ...] = (search.choose(config.find, config.driver),)
        if config.buttons.find:
            self._found += (search.choose(config.buttons.find, INPUTS_ONLY),)
        self._signs = signs.load(config.signs)
        opened = OpenedDevice(config, self._signs, self._found)
        self.axes = opened.plan.joints
        self._opened: OpenedDevice | None = opened
        self._seeker: Seeker[OpenedDevice] | None = None
        self._lost = ""
        self._memory = mapping.start(self.axes)
        self._time_s = 0.0
        for line in described(config, self._found, self._signs):
            say(line)

    def read(self, time_s: float) -> HandState:
        """Return the newest hand state.

        `DeviceLost` while the device is away, and once when reports were lost, and with them maybe
        a button that was pressed or let go of.
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
            raise DeviceLost("reports were lost, as nobody read them in time")
        return hand

    def write(self, force: Axes) -> None:
        """Have `force` [N] rendered until the next write; nothing, while the device is away."""
        if len(force) != self.axes or not all(map(math.isfinite, force)):
            raise DeviceFault(f"refuses force {force}")
        if self._opened is not None:
            self._opened.device.post(mapping.shares(self._opened.plan, force))

    def close(self) -> None:
        """Take the force away and let go; a device that hangs is not waited for."""
        opened, self._opened = self._opened, None
        if opened is not None:
            opened.end(_PATIENCE_S)
        if self._seeker is not None:
            self._seeker.end(_PATIENCE_S)

    def _lose(self, opened: OpenedDevice, fault: DeviceFault) -> DeviceLost:
        self._opened = None
        self._memory = mapping.start(self.axes)._replace(position=self._memory.position)
        self._lost = f"{fault}; waiting for it"
        before = search.beside(self._found[0]) | search.beside(self._found[-1])
        self._seeker = Seeker(opened, lambda: self._open_again(before))
        return DeviceLost(self._lost)

    def _open_again(self, before: frozenset[str]) -> OpenedDevice:
        device, *switches = self._found
        back = [search.again(device, before, CLAIMS.paths())]
        if CLAIMS.is_ambiguous(device.item):
            raise DeviceFault(
                f"{device.item}: was lost together with another one like it, and their serial "
                "numbers do not tell which is which; restart the master"
            )
        back += [search.again(one, before) for one in switches]
        return OpenedDevice(self._config, self._signs, tuple(back))

    def _returned(self) -> OpenedDevice:
        assert self._seeker is not None  # noqa: S101 - set when the device was lost
        if self._seeker.found is None:
            raise DeviceLost(self._seeker.trouble or self._lost)
        self._opened, self._seeker = self._seeker.found, None
        return self._opened


def trusted(found: FoundDevice, known: Signs) -> bool:
    """Return whether a device may push by itself: it was found to push each axis as it should.

    One whose sign is -1 has a motor that is wired the other way round, and then its own spring
    pushes away, or else another convention. Nobody can tell.
    """
    signs_found = known.of(found.pusher)
    return found.kind == PID and all(
        signs_found.get(axis) == 1 for axis in PidDriver(found.descriptor).forces
    )


def described(config: HidConfig, found: tuple[FoundDevice, ...], known: Signs) -> list[str]:
    """Return what the operator should know of a device that was just opened."""
    lines = [f"device: {found[0].item}, driver {found[0].kind}"]
    lines += [f"buttons: {one.item}, driver {one.kind}" for one in found[1:]]
    names = mapping.unsigned(config, known.of(found[0].pusher))
    if names:
        lines.append(
            f"WARNING: no force on {', '.join(names)}: the sign is not known; find it with "
            "`teleop devices test`"
        )
    if config.pid != PidConfig() and not trusted(found[0], known):
        lines.append(
            "WARNING: no pid.spring and no pid.damper, which could push away from the centre: "
            "`teleop devices test` has not found a sign of +1 for each axis of a PID device"
        )
    return lines
