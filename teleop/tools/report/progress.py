"""Progress of a computation: a bar on a terminal, else a line per step."""

import sys
from typing import TextIO

WIDTH = 40


class Progress:
    """Shows the present step and the fraction done."""

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._bar = self._stream.isatty()
        self._what = ""

    def __call__(self, what: str, share: float) -> None:
        """Show that `share` (0 to 1) of `what` is done."""
        if self._bar:
            filled = "#" * round(WIDTH * share)
            print(f"\r\x1b[K[{filled:<{WIDTH}}] {what}", end="", file=self._stream, flush=True)
        elif what != self._what:
            print(f"{what} ...", file=self._stream, flush=True)
        self._what = what

    def end(self) -> None:
        """Clear the line."""
        if self._bar and self._what:
            print("\r\x1b[K", end="", file=self._stream, flush=True)
