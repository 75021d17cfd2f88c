"""Registry of the nodes open in this process, so that no device is opened twice."""

import os
import threading
from collections import Counter
from typing import NamedTuple

from master.device import DeviceFault
from master.devices.hid.drivers import AttachedNode


class _FileIdentity(NamedTuple):
    """Identity of a device file; not its times, as a change of permissions changes them."""

    system: int
    inode: int


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
            alike = sum(claim.identity == item.identity for claim in self._open.values())
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
    return _FileIdentity(status.st_dev, status.st_ino)


CLAIMS = Claims()  # of this process
