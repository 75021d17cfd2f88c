"""Timing of a control loop: reports while it runs, and its part of the summary."""

from collections import Counter
from collections.abc import Mapping, Sequence

from teleop.link.health import LinkSummary
from teleop.link.reception import REJECTION_COUNTERS, REPORTED_COUNTERS, MessageCounts
from teleop.messages.messages import NO_TOPICS, STAGE_NAMES, Latency, LoopReport
from teleop.messages.topics import Role
from teleop.runtime.clock import Durations, Percentiles, Span, TickStats, now_ns
from teleop.session.state_machine import DetailedReason, Reason, SessionOutline, State
from teleop.session.summary import LoopSummary

# --- durations of the stages from hand to force


class StageMeter:
    """Durations of the stages of `STAGE_NAMES`, for the whole run and since the last report."""

    def __init__(self) -> None:
        self.durations = tuple(Durations() for _ in STAGE_NAMES)

    def add(self, durations_ns: Sequence[int]) -> None:
        """Add one command; a duration [ns] per stage."""
        for stage, duration in zip(self.durations, durations_ns, strict=True):
            stage.add(duration)

    @staticmethod
    def build_message(role: Role, spans: Sequence[Span]) -> Latency:
        """Return the message for listeners of a span of each stage."""
        return Latency(
            role=role,
            answered=spans[0].values,
            p50_ns=tuple(span.p50 for span in spans),
            p99_ns=tuple(span.p99 for span in spans),
            p99_9_ns=tuple(span.p99_9 for span in spans),
            max_ns=tuple(span.largest for span in spans),
        )

    def build_summary(self) -> dict[str, Percentiles]:
        """Return percentiles [us] of the whole run, by the stages' names."""
        return {
            name: stage.compute_percentiles(1e-3)
            for name, stage in zip(STAGE_NAMES, self.durations, strict=True)
        }


REPORT_PERIOD_NS = 500_000_000


class LoopMeter:
    """Measures one loop's grid, the work of its ticks and, on the master, its round trips."""

    def __init__(self, role: Role, stats: TickStats) -> None:
        self.work = Durations()
        self.latency = Durations()
        self.answer = Durations()  # from the start of a tick to its message on the link
        self.without_rig = Durations()  # work, without the computation of a simulated rig
        self.stages = StageMeter()
        self.unreported = self.work, self.answer, self.without_rig  # of the whole run only
        self._role, self._stats = role, stats
        self._due_ns = now_ns() + REPORT_PERIOD_NS
        self._ticks = 0
        self._since_ns = now_ns()
        self._in_state: Counter[State] = Counter()  # ticks
        self._faults: list[DetailedReason] = []
        self._pending: DetailedReason | None = None  # the fault since the last engagement
        self._degraded: DetailedReason | None = None  # why it was last degraded
        self._degraded_ticks = 0
        self._state = State.OFF
        self._side: SessionOutline | None = None
        self._reason = self._not_usable = DetailedReason(Reason.NOT_USABLE)

    def add_tick(self, side: SessionOutline, work_ns: int, detail: str = "") -> None:
        """Add one tick that left the session at `side` and took `work_ns` [ns].

        `detail` of the session's reason: which tendon, or why it is not usable.
        """
        self.work.add(work_ns)
        self._in_state[side.state] += 1
        if side.state is State.ENGAGED and side.reason is Reason.CALIBRATION_DUE:
            self._degraded = DetailedReason(side.reason, detail)
            self._degraded_ticks += 1
        if side is self._side and detail == self._reason.detail:
            return
        self._side = side
        self._reason = DetailedReason(side.reason, detail)
        if side.reason is Reason.NOT_USABLE:
            self._not_usable = self._reason
        if side.state is State.FAULT and self._state is not State.FAULT:
            self._faults.append(self._reason)
            if self._state in (State.ENGAGED, State.CLUTCHED, State.HOLDING):
                self._pending = self._reason
        if side.state is State.ENGAGED:
            self._pending = None
        self._state = side.state

    def is_due(self, stamp_ns: int) -> bool:
        """Return whether a report is due at `stamp_ns`; the next one is a period later."""
        if stamp_ns < self._due_ns:
            return False
        periods = 1 + (stamp_ns - self._due_ns) // REPORT_PERIOD_NS  # several after a stall
        self._due_ns += periods * REPORT_PERIOD_NS
        return True

    def build_report(
        self,
        stamp_ns: int,
        side: SessionOutline,
        counts: MessageCounts,
        sent: tuple[int, ...] = NO_TOPICS,
        ended: bool = False,
    ) -> LoopReport:
        """Return the report since the last one; `sent` as of `Link.list_last_sequences`."""
        stats = self._stats
        rate_hz = (stats.ticks - self._ticks) * 1e9 / max(stamp_ns - self._since_ns, 1)
        self._ticks, self._since_ns = stats.ticks, stamp_ns
        span = self.latency.take_span()
        return LoopReport(
            role=self._role,
            state=side.state,
            reason=side.reason,
            ticks=stats.ticks,
            overruns=stats.overruns,
            **{name: getattr(counts, name) for name in REPORTED_COUNTERS},
            rate_hz=rate_hz,
            lateness_max_ns=stats.lateness_max_ns,
            latency_p50_ns=span.p50,
            latency_p99_ns=span.p99,
            ended=int(ended),
            sent=sent,
        )

    def build_summary(
        self,
        side: SessionOutline,
        counts: MessageCounts,
        verdicts: Mapping[str, int],
        link: LinkSummary,
    ) -> LoopSummary:
        """Return the summary of the whole run."""
        stats = self._stats
        return LoopSummary(
            role=self._role,
            seconds=(stats.last_ns - stats.first_ns) * 1e-9,
            ticks=stats.ticks,
            rate_hz=stats.rate_hz,
            overruns=stats.overruns,
            lateness_max_ms=stats.lateness_max_ns * 1e-6,
            work_us=self.work.compute_percentiles(1e-3),
            answer_us=self.answer.compute_percentiles(1e-3),
            without_rig_us=self.without_rig.compute_percentiles(1e-3),
            latency_ms=self.latency.compute_percentiles(1e-6),
            stages_us=self.stages.build_summary(),
            received=counts.received,
            lost=counts.lost,
            overwritten=counts.overwritten,
            rejected={kind: getattr(counts, kind) for kind in REJECTION_COUNTERS},
            unknown=counts.unknown,
            delayed=counts.delayed,
            clock_jumps=counts.clock_jumps,
            restarts=counts.restarts,
            gate=dict(verdicts),
            ticks_in={state: self._in_state[state] for state in State},
            faults=tuple(self._faults),
            final_state=side.state,
            reason=self._reason,
            not_usable=self._not_usable,
            ended_in=self._reason if side.state in (State.FAULT, State.STOPPED) else self._pending,
            link=link,
            degraded=self._degraded,
            degraded_ticks=self._degraded_ticks,
        )
