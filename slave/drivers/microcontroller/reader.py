"""A microcontroller that is only listened to: it sends its states by itself."""

import time

from slave.drivers.driver import DriverFault
from slave.drivers.microcontroller.driver import MicrocontrollerDriver
from slave.drivers.microcontroller.frames import BoardInfo, FrameType

LISTEN_S = 6.0  # [s] within which a state must come; a board may restart as its port is opened


class MicrocontrollerReader(MicrocontrollerDriver):
    """A `MicrocontrollerDriver` that sends nothing and takes no targets."""

    def _greet(self) -> BoardInfo:
        """Wait for a state, which tells what the board has."""
        until_s = time.monotonic() + LISTEN_S
        while time.monotonic() < until_s:
            for frame in self._receive():
                if frame.kind == FrameType.STATE:
                    state = self._parse(frame)
                    self._reader.bad = self._reader.lost = 0  # a frame was cut at opening
                    watchdog_ms = round(self._config.watchdog * 1e3)
                    return BoardInfo(watchdog_ms, 0, len(state.position), len(state.cell), "")
        raise DriverFault(f"{self._config.port}: no states of a board within {LISTEN_S:g} s")

    def _send(self, kind: FrameType, body: bytes = b"") -> None:
        """Send nothing."""
