"""What a process has refused, in words: few, however much is refused."""

from collections import OrderedDict
from threading import Lock

REFUSAL_KINDS_MAX = 16  # kept between two readings; of further ones only their number


class RefusalCounter:
    """Lines for people, with how often each was refused; any thread may use it."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._counts: OrderedDict[str, int] = OrderedDict()
        self._further = 0

    def note(self, what: str, times: int = 1) -> None:
        """Note a refusal."""
        with self._lock:
            if what in self._counts:
                self._counts[what] += times
            elif len(self._counts) < REFUSAL_KINDS_MAX:
                self._counts[what] = times
            else:
                self._further += times

    def take(self) -> list[str]:
        """Return the refusals since the last call as lines."""
        if not self._counts:
            return []
        with self._lock:
            counts, self._counts = self._counts, OrderedDict()
            further, self._further = self._further, 0
        lines = [f"refused: {what}" + (f" ({n} times)" if n > 1 else "")
                 for what, n in counts.items()]  # fmt: skip
        return lines + ([f"refused: {further} more"] if further else [])
