"""The live status line of a session."""

import shutil
import sys
import threading
from typing import TextIO

from teleop.messages import PHASE_NAMES, STAGE_NAMES, Latency, LoopReport, SlaveState, TendonState
from teleop.session import State
from teleop.summary import format_latency
from teleop.topics import Role


class StatusLine:
    """One line kept at the bottom of a terminal, with ordinary lines printed above it.

    Without a terminal only ordinary lines are printed.

    Attributes
    ----------
    live : bool
        Whether there is a terminal.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream, self._line = stream or sys.stdout, ""
        self.live = self._stream.isatty()
        self._lock = threading.Lock()

    def say(self, text: str) -> None:
        """Print an ordinary line."""
        with self._lock:
            self._stream.write(("\r\x1b[K" if self.live else "") + text + "\n" + self._line)
            self._stream.flush()

    def show(self, text: str) -> None:
        """Replace the status line."""
        if not self.live:
            return
        with self._lock:
            self._line = text[: shutil.get_terminal_size().columns - 1]
            self._stream.write("\r\x1b[K" + self._line)
            self._stream.flush()

    def clear(self) -> None:
        """Remove the status line."""
        self.show("")


def status_text(
    reports: dict[Role, LoopReport],
    state: SlaveState | None,
    tendons: TendonState | None,
    latency: Latency | None = None,
) -> str:
    """Return the status of a session in one line."""
    master, slave = reports.get(Role.MASTER), reports.get(Role.SLAVE)
    parts = [State(master.state).name.lower() if master else "waiting for the master"]
    parts.append(f"slave {slave.rate_hz:.0f} Hz" if slave else "slave starting")
    if master:
        parts.append(f"master {master.rate_hz:.0f} Hz")
        if latency and latency.answered:
            quantiles = (latency.p50_ns, latency.p99_ns, latency.p99_9_ns, latency.max_ns)
            medians = dict(zip(STAGE_NAMES, (ns * 1e-6 for ns in latency.p50_ns), strict=True))
            parts.append("latency " + format_latency([q[-1] * 1e-6 for q in quantiles], medians))
        elif master.latency_p50_ns:
            parts.append(
                f"latency {master.latency_p50_ns / 1e6:.1f}/{master.latency_p99_ns / 1e6:.1f} ms"
            )
    if state and state.joints:
        parts.append("force " + " ".join(f"{f:6.2f}" for f in state.force[: state.joints]) + " N")
    if tendons and tendons.tendons and tendons.phase[0] < len(PHASE_NAMES):
        parts.append(PHASE_NAMES[tendons.phase[0]])
    return " │ ".join(parts)
