"""Registry of the nodes open in this process, so that no device is opened twice."""

import threading
from collections import Counter

from master.device import DeviceFault
from master.devices.hid.drivers import AttachedNode


class Claims:
    """The open devices; thread-safe.

    A device with buttons alone (`buttons.find`) is not claimed: one pedal may serve two hands.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._open: dict[str, str] = {}  # identity of the device at each path
        self._most: Counter[str] = Counter()  # of each identity, largest number open at once

    def claim(self, item: AttachedNode) -> None:
        """Claim a device; `DeviceFault` if it is in use."""
        with self._lock:
            if item.path in self._open:
                raise DeviceFault(
                    f"{item}: already in use by another device of this session; set find to a "
                    "serial number or path"
                )
            self._open[item.path] = item.identity
            alike = sum(identity == item.identity for identity in self._open.values())
            self._most[item.identity] = max(self._most[item.identity], alike)

    def release(self, item: AttachedNode) -> None:
        """Release a device."""
        with self._lock:
            self._open.pop(item.path, None)

    def forget(self) -> None:
        """Reset, as in a new process."""
        with self._lock:
            self._open.clear()
            self._most.clear()

    def paths(self) -> frozenset[str]:
        """Return the paths of the claimed devices."""
        with self._lock:
            return frozenset(self._open)

    def is_ambiguous(self, item: AttachedNode) -> bool:
        """Return whether a device that came back may be any of several that were unplugged.

        Two devices open at once with the same identity (no serial number, or the same one) differ
        only in their paths. If both were unplugged, each may come back at the other's path.
        """
        with self._lock:
            here = sum(identity == item.identity for identity in self._open.values())
            return self._most[item.identity] - here > 1


CLAIMS = Claims()  # of this process
