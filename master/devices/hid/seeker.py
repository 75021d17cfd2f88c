"""Looking for a device that went away, in a thread of its own."""

import threading
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from master.device import DeviceFault
from master.devices.hid.search import NotThereError

LOOK_S = 0.1  # between two looks
_FAILURES = 20  # in a row are told of; a device is not usable in the first moments


class Closable(Protocol):
    """What is looked for."""

    def end(self, patience_s: float = 0.0) -> bool:
        """Let go of it; return whether that was done in time. May be called again."""


T = TypeVar("T", bound=Closable)


class Seeker(Generic[T]):
    """Ends what broke, then tries `open_again` until it succeeds.

    What broke is waited for: its last word must not reach what is opened next.

    Attributes
    ----------
    found : object or None
        What was opened, once it was.
    trouble : str
        Why it cannot be opened although it is attached; empty as long as that may be a matter of
        time.
    """

    def __init__(self, broken: T, open_again: Callable[[], T]) -> None:
        self.found: T | None = None
        self.trouble = ""
        self._broken, self._open = broken, open_again
        self._lock, self._over = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="hid seeker", daemon=True)
        self._thread.start()

    def end(self, patience_s: float) -> None:
        """Stop looking, and let go of what was found but not taken."""
        with self._lock:
            self._over.set()
        self._thread.join(patience_s)
        if self.found is not None:
            self.found.end(patience_s)

    def _run(self) -> None:
        failures = 0
        while not self._over.is_set():
            try:
                if self._broken.end(LOOK_S):
                    self._keep(self._open())
                    return
            except NotThereError:
                failures, self.trouble = 0, ""
            except Exception as error:
                failures += 1
                if failures == _FAILURES:
                    expected = isinstance(error, DeviceFault)
                    self.trouble = str(error) if expected else f"cannot be looked for: {error!r}"
            self._over.wait(LOOK_S)

    def _keep(self, found: T) -> None:
        with self._lock:
            if not self._over.is_set():
                self.found = found
                return
        found.end()
