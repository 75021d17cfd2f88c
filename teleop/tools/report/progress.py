"""How far a diagnosis is: a bar on a terminal, a line for each thing done elsewhere."""

import sys
from typing import TextIO

WIDTH = 40


class Progress:
    """Shows what is being done, and which share of it is; call it with both."""

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
        """Leave the line free for what is printed next."""
        if self._bar and self._what:
            print("\r\x1b[K", end="", file=self._stream, flush=True)
