"""Counting calls between two points of a program."""

import sys
from collections import Counter
from pathlib import Path

HERE = str(Path(__file__).parent)


class Calls:
    """Counts function calls of the thread in spans from `begin` to the call of a function.

    Calls of this folder are not counted: they are the measurement's own.

    Attributes
    ----------
    python, c : Counter
        Calls by the name of the function. `python` are the 'call' events of `sys.setprofile`,
        among them those that enter compiled code; `c` are its 'c_call' events.
    spans, ended : int
        How many times `begin` was called, and how often the code that it named.
    """

    def __init__(self) -> None:
        self.python: Counter[str] = Counter()
        self.c: Counter[str] = Counter()
        self.spans = 0
        self.ended = 0
        self._ends_at: object = None

    def begin(self, ends_at: object) -> None:
        """Count from now on until `ends_at` is called: a function of C, or the code of one."""
        self.spans += 1
        self._ends_at = ends_at
        sys.setprofile(self._count)

    def pause(self) -> bool:
        """Stop counting; return whether it was on."""
        on = sys.getprofile() is not None
        sys.setprofile(None)
        return on

    def resume(self) -> None:
        """Go on counting."""
        sys.setprofile(self._count)

    def per_span(self) -> tuple[float, float]:
        """Return calls of Python and of C in each span, on average."""
        return self.python.total() / self.spans, self.c.total() / self.spans

    def table(self) -> str:
        """Return the calls of a span by function, most frequent first."""
        lines = [f"{n / self.spans:8.2f}  {name}" for name, n in self.python.most_common()]
        python, c = self.per_span()
        return "\n".join([f"{python:.2f} Python calls in a tick, {c:.2f} of C:", *lines])

    def _count(self, frame, event, arg) -> None:
        if event == "call" and frame.f_code is self._ends_at:
            self.ended += 1
            sys.setprofile(None)
        if event not in ("call", "c_call") or frame.f_code.co_filename.startswith(HERE):
            return
        if event == "call":
            self.python[frame.f_code.co_qualname] += 1
            ended = frame.f_code is self._ends_at
        else:
            self.c[getattr(arg, "__qualname__", str(arg))] += 1
            ended = arg == self._ends_at
        if ended:
            sys.setprofile(None)
