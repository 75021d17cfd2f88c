"""Which nodes this process has open as devices, so that no two hands get the same one."""

import threading
from collections import Counter

from master.device import DeviceFault
from master.devices.hid.drivers import AttachedNode


class Claims:
    """The devices that are open; any thread may ask.

    A device with buttons alone (`buttons.find`) is not claimed: one pedal may serve two hands.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._open: dict[str, str] = {}  # identity of the device at each path
        self._most: Counter[str] = Counter()  # of each identity that were ever open together

    def claim(self, item: AttachedNode) -> None:
        """Take a device; `DeviceFault` if another hand has it."""
        with self._lock:
            if item.path in self._open:
                raise DeviceFault(
                    f"{item}: is in use as another device of this session; name one in find, by "
                    "serial or path"
                )
            self._open[item.path] = item.identity
            alike = sum(identity == item.identity for identity in self._open.values())
            self._most[item.identity] = max(self._most[item.identity], alike)

    def release(self, item: AttachedNode) -> None:
        """Let another hand have it."""
        with self._lock:
            self._open.pop(item.path, None)

    def forget(self) -> None:
        """Begin anew, as a process that has opened nothing."""
        with self._lock:
            self._open.clear()
            self._most.clear()

    def paths(self) -> frozenset[str]:
        """Return where the devices are that some hand has."""
        with self._lock:
            return frozenset(self._open)

    def is_ambiguous(self, item: AttachedNode) -> bool:
        """Return whether a device that came back may be any of several that went away.

        Two that were open at once and say the same of themselves, having no serial number or the
        same one, are told apart by their places only. When they went away together, each may come
        back in the other's.
        """
        with self._lock:
            here = sum(identity == item.identity for identity in self._open.values())
            return self._most[item.identity] - here > 1


CLAIMS = Claims()  # of this process
