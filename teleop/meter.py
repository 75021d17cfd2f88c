"""How a control loop keeps its time: reports while it runs, and its part of the summary after."""

from collections import Counter
from collections.abc import Mapping
from typing import Any

from teleop.clock import Grid, now_ns
from teleop.link import Counts
from teleop.messages import LoopReport
from teleop.session import Reason, SessionOutline, State
from teleop.timing import Durations
from teleop.topics import Role

REPORT_PERIOD_NS = 500_000_000


class LoopMeter:
    """Watches one loop's grid, the work of its ticks and, on the master, its round trips."""

    def __init__(self, role: Role, grid: Grid) -> None:
        self.work = Durations()
        self.latency = Durations()
        self._role, self._grid = role, grid
        self._due_ns = now_ns() + REPORT_PERIOD_NS
        self._ticks = 0
        self._since_ns = now_ns()
        self._in_state: Counter[State] = Counter()  # ticks
        self._faults: list[str] = []
        self._pending = ""  # the fault after which nobody has engaged again
        self._state = State.OFF
        self._words = self._not_usable = Reason.NOT_USABLE.text

    def tick(self, side: SessionOutline, work_ns: int, detail: str = "") -> None:
        """Count one tick, which left the session at `side` and took `work_ns` [ns].

        `detail` says what the session's reason is about: which tendon, or why it is not usable.
        """
        self._words = format_reason(side.reason, detail)
        if side.reason is Reason.NOT_USABLE:
            self._not_usable = self._words
        self.work.add(work_ns)
        self._in_state[side.state] += 1
        if side.state is State.FAULT and self._state is not State.FAULT:
            self._faults.append(self._words)
            if self._state in (State.ENGAGED, State.CLUTCHED, State.HOLDING):
                self._pending = self._words
        if side.state is State.ENGAGED:
            self._pending = ""
        self._state = side.state

    def report(self, stamp_ns: int, side: SessionOutline, counts: Counts) -> LoopReport | None:
        """Return the report that is due at `stamp_ns`, or None."""
        if stamp_ns < self._due_ns:
            return None
        periods = 1 + (stamp_ns - self._due_ns) // REPORT_PERIOD_NS  # several after a stall
        self._due_ns += periods * REPORT_PERIOD_NS
        stats = self._grid.stats
        rate_hz = (stats.ticks - self._ticks) * 1e9 / (stamp_ns - self._since_ns)
        self._ticks, self._since_ns = stats.ticks, stamp_ns
        p50, p99 = self.latency.take_span()
        self.work.take_span()
        return LoopReport(
            role=self._role,
            state=side.state,
            reason=side.reason,
            ticks=stats.ticks,
            overruns=stats.overruns,
            received=counts.received,
            lost=counts.lost,
            rejected=counts.rejected,
            corrupted=counts.corrupted,
            repeated=counts.repeated,
            out_of_order=counts.out_of_order,
            foreign=counts.foreign,
            unknown=counts.unknown,
            delayed=counts.delayed,
            clock_jumps=counts.clock_jumps,
            restarts=counts.restarts,
            rate_hz=rate_hz,
            lateness_max_ns=stats.lateness_max_ns,
            latency_p50_ns=p50,
            latency_p99_ns=p99,
        )

    def summary(
        self, side: SessionOutline, counts: Counts, verdicts: Mapping[str, int]
    ) -> dict[str, Any]:
        """Return what the whole run was like."""
        stats = self._grid.stats
        return {
            "role": self._role.name.lower(),
            "seconds": (stats.last_ns - stats.first_ns) * 1e-9,
            "ticks": stats.ticks,
            "rate_hz": stats.rate_hz,
            "overruns": stats.overruns,
            "lateness_max_ms": stats.lateness_max_ns * 1e-6,
            "work_us": percentiles(self.work, 1e-3),
            "latency_ms": percentiles(self.latency, 1e-6),
            "received": counts.received,
            "lost": counts.lost,
            "overwritten": counts.overwritten,
            "rejected": {
                kind: getattr(counts, kind)
                for kind in ("corrupted", "layout", "repeated", "out_of_order", "foreign")
            },
            "unknown": counts.unknown,
            "delayed": counts.delayed,
            "clock_jumps": counts.clock_jumps,
            "restarts": counts.restarts,
            "gate": dict(verdicts),
            "ticks_in": {state.name.lower(): self._in_state[state] for state in State},
            "faults": self._faults,
            "final_state": side.state.name.lower(),
            "reason": self._words,
            "not_usable": self._not_usable,
            "ended_in": self._words
            if side.state in (State.FAULT, State.STOPPED)
            else self._pending,
        }


def format_reason(reason: Reason, detail: str) -> str:
    """Return a reason, and what it is about, in one line."""
    return f"{reason.text}: {detail}" if detail else reason.text


def percentiles(durations: Durations, unit: float) -> dict[str, float | int | None]:
    """Return p50, p99, p99.9 and the number of values; `unit` converts from nanoseconds."""
    out: dict[str, float | int | None] = {"n": durations.count}
    for name, percent in (("p50", 50.0), ("p99", 99.0), ("p99_9", 99.9)):
        value = durations.percentile_ns(percent)
        out[name] = None if value is None else value * unit
    return out
