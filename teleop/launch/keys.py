"""Single keys of the launcher's terminal: space is the emergency stop."""

import os
import select
import sys
import termios
import time
import tty
from typing import Any, Self

KEY_HELP = "space: emergency stop, r: reset it, Ctrl-C: end"


class KeyReader:
    """Context manager that reads single keys; none without a controlling terminal."""

    def __init__(self) -> None:
        self._terminal = -1
        self._before: list[Any] = []

    def __enter__(self) -> Self:
        if sys.stdin.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp():
            self._terminal = sys.stdin.fileno()
            self._before = termios.tcgetattr(self._terminal)
            tty.setcbreak(self._terminal)  # single keys without echo; Ctrl-C still works
        return self

    def __exit__(self, *_: object) -> None:
        if self._terminal >= 0:
            termios.tcsetattr(self._terminal, termios.TCSADRAIN, self._before)
            self._terminal = -1

    @property
    def there(self) -> bool:
        """Whether keys can be read."""
        return self._terminal >= 0

    def wait(self, seconds: float) -> str:
        """Return the keys pressed within `seconds` [s], as soon as there are any."""
        if not self.there:
            time.sleep(seconds)
            return ""
        if not select.select([self._terminal], [], [], seconds)[0]:
            return ""
        pressed = os.read(self._terminal, 64)
        if not pressed:  # the terminal was closed
            self._terminal = -1
        return pressed.decode(errors="replace")
