"""What a recorder tells while it runs: how far it is behind, and what is missing."""

from teleop.runtime.process import STATUS, is_supervised
from teleop.runtime.status_line import StatusLine

STATUS_PERIOD_NS = 500_000_000  # between two messages to the launcher
LAG_WARNING_NS, LAG_RECOVERED_NS = (
    1_000_000_000,
    200_000_000,
)  # lag that is told, and when it is over
DRAINING_NS = 1_000_000_000  # between two lines at the end


class RecordingProgress:
    """Shows a recorder's status: in its terminal, or through the launcher.

    A lag above `LAG_WARNING_NS`, its end, and the first missing message are lines that stay.
    """

    def __init__(self, status: StatusLine) -> None:
        self._status = status
        self._shown_ns = self._told_ns = 0
        self._is_behind, self._is_missing = False, False

    def show(self, now_ns: int, lag_ns: int, missing: int, draining: bool) -> None:
        """Show the present status, at intervals."""
        text = format_status(lag_ns, missing)
        if now_ns - self._shown_ns >= STATUS_PERIOD_NS:
            self._shown_ns = now_ns
            if is_supervised():
                print(f"{STATUS}{text}", flush=True)
            else:
                self._status.show(text)
        if draining and lag_ns and now_ns - self._told_ns >= DRAINING_NS:
            self._told_ns = now_ns
            self._say(f"writing what has come: {lag_ns * 1e-9:.1f} s behind")
        if lag_ns > LAG_WARNING_NS and not self._is_behind and not draining:
            self._is_behind = True
            self._say(f"{text}: the disk or the processor is too slow; it keeps at most 10 s")
        elif lag_ns < LAG_RECOVERED_NS and self._is_behind:
            self._is_behind = False
            self._say("caught up")
        if missing and not self._is_missing:
            self._is_missing = True
            self._say(f"{missing} messages missing so far; the summary counts them by topic")

    def clear(self) -> None:
        """Remove the status line."""
        self._status.clear()

    def _say(self, text: str) -> None:
        self._status.say(text if is_supervised() else f"recorder: {text}")


def format_status(lag_ns: int, missing: int) -> str:
    """Return the status of a recorder in words."""
    lack = f", {missing} missing" if missing else ""
    return f"recorder {lag_ns * 1e-9:.1f} s behind{lack}"
