"""The live status line of a terminal."""

import sys
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Self, TextIO

if TYPE_CHECKING:  # 70 ms of each start of a slave, which shows none
    from rich.console import RenderableType
    from rich.live import Live
    from rich.text import Text

_PERIOD_S = 0.2  # between two drawings of the status line


class StatusLine:
    """One line kept at the bottom of a terminal, with ordinary lines printed above it.

    Only ordinary lines are printed without a terminal; `live` is whether there is one.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        from rich.console import Console

        stream = stream or sys.stdout
        self._console = Console(file=stream, force_terminal=stream.isatty(), highlight=False)
        self.live = self._console.is_terminal and not self._console.is_dumb_terminal
        self._lock = threading.Lock()
        self._display: Live | None = None
        self._drawn_s = -_PERIOD_S

    def say(self, text: "str | RenderableType") -> None:
        """Print an ordinary line, or a table."""
        with self._lock:
            if isinstance(text, str):
                self._console.print(text, markup=False, soft_wrap=True)
            else:
                self._console.print(text)
            self._console.file.flush()

    def show(self, text: "str | Text") -> None:
        """Replace the status line; it is drawn a few times a second at most."""
        from rich.live import Live
        from rich.text import Text

        now = time.monotonic()
        if not self.live or now - self._drawn_s < _PERIOD_S:
            return
        line = Text(text) if isinstance(text, str) else text
        line.no_wrap, line.overflow = True, "ellipsis"
        with self._lock:
            self._drawn_s = now
            if self._display is None:
                self._display = Live(
                    console=self._console,
                    auto_refresh=False,
                    transient=True,
                    redirect_stdout=False,
                    redirect_stderr=False,
                )
                self._display.start()
            self._display.update(line, refresh=True)

    def clear(self) -> None:
        """Remove the status line."""
        with self._lock:
            if self._display is not None:
                self._display.stop()
                self._display = None
            self._drawn_s = -_PERIOD_S


# --- progress of a computation: a bar on a terminal, else a line per step

WIDTH = 40
_SETTLED = 2.0  # [s] before which the remaining time is not told


class Progress:
    """Shows the present step, the fraction done and, on a terminal, the remaining time.

    A callback for what takes long, on standard error; a context manager that clears it:

        with Progress() as progress:
            est.diagnose(run, progress=progress)
    """

    def __init__(
        self, stream: TextIO | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._clock, self._begun = clock, clock()
        self._stream = sys.stderr if stream is None else stream
        self._bar = self._stream.isatty()
        self._what = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def __call__(self, task: str, share: float) -> None:
        """Show that `share` (0 to 1) of all is done, and `task` is being done."""
        if self._bar:
            filled = "#" * round(WIDTH * share)
            text = f"\r\x1b[K[{filled:<{WIDTH}}] {task}{self._estimate_remaining(share)}"
            print(text, end="", file=self._stream, flush=True)
        elif task != self._what:
            print(f"{task} ...", file=self._stream, flush=True)
        self._what = task

    def _estimate_remaining(self, share: float) -> str:
        elapsed = self._clock() - self._begun
        if elapsed < _SETTLED or not share > 0.0:
            return ""
        left_s = elapsed * (1.0 - share) / share
        left = f"{left_s:.0f} s" if left_s < 90.0 else f"{left_s / 60:.0f} min"
        return f", about {left} left"

    def end(self) -> None:
        """Clear the line."""
        if self._bar and self._what:
            print("\r\x1b[K", end="", file=self._stream, flush=True)
