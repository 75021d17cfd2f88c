"""Thread that searches for an unplugged device."""

import threading
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from master.device import DeviceFault
from master.devices.hid.search import DeviceNotFoundError

POLL_PERIOD_S = 0.1  # between two looks
_FAILURES_REPORTED = (
    20  # consecutive failures before they are reported; a device is not usable at once
)


class Closable(Protocol):
    """An object that can be closed."""

    def end(self, patience_s: float = 0.0) -> bool:
        """Close it; return whether that was done in time. May be called again."""


T = TypeVar("T", bound=Closable)


class DeviceReconnection(Generic[T]):
    """Closes the failed device, then tries `open_again` until it succeeds.

    The failed device is closed completely first, so that its last report does not reach the next
    one.

    Attributes
    ----------
    found : object or None
        The opened device, once available.
    trouble : str
        Why an attached device cannot be opened; empty while it may only need time.
    """

    def __init__(self, broken: T, open_again: Callable[[], T]) -> None:
        self.found: T | None = None
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

    def _keep(self, found: T) -> None:
        with self._lock:
            if not self._over.is_set():
                self.found = found
                return
        found.end()
