"""Progress of a computation: a bar on a terminal, else a line per step."""

import sys
import time
from collections.abc import Callable
from typing import TextIO

WIDTH = 40
_SETTLED = 2.0  # [s] before which the remaining time is not told


class Progress:
    """Shows the present step, the fraction done and, on a terminal, the remaining time."""

    def __init__(
        self, stream: TextIO | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._clock, self._begun = clock, clock()
        self._stream = sys.stderr if stream is None else stream
        self._bar = self._stream.isatty()
        self._what = ""

    def __call__(self, what: str, share: float) -> None:
        """Show that `share` (0 to 1) of all is done, and `what` is being done."""
        if self._bar:
            filled = "#" * round(WIDTH * share)
            text = f"\r\x1b[K[{filled:<{WIDTH}}] {what}{self._remaining(share)}"
            print(text, end="", file=self._stream, flush=True)
        elif what != self._what:
            print(f"{what} ...", file=self._stream, flush=True)
        self._what = what

    def _remaining(self, share: float) -> str:
        elapsed = self._clock() - self._begun
        if elapsed < _SETTLED or not share > 0.0:
            return ""
        left = elapsed * (1.0 - share) / share
        return f", about {left:.0f} s left" if left < 90.0 else f", about {left / 60:.0f} min left"

    def end(self) -> None:
        """Clear the line."""
        if self._bar and self._what:
            print("\r\x1b[K", end="", file=self._stream, flush=True)
