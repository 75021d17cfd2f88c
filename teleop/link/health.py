"""Health of the link to the peer: clock offset, round trip, jitter, loss, delay in each direction.

Everything is found from what the messages carry: the sender's stamp, the echo of our own newest
stamp that the sender had, and sequence numbers. With our stamp `e` echoed in a message that the
peer sent at `s` of its clock and that we received at `r` of ours, the offset of the peer's clock,
theta = peer's - ours, is certified by

    s - r  <=  theta  <=  s - hold - e        (no message arrives before it is sent)

where `hold` is how long the peer kept our message, if it says so. `LinkWindow` keeps the tightest
bounds of one to two `WINDOW_NS`; half their distance is the uncertainty of the offset. Bounds that
contradict each other show that a clock was set. Jitter is the mean |D| of RFC 3550, section 6.4.1.

`update_link_window` takes a message, `take_measurement` ends a span of them, `step` decides what
follows.
"""

from collections import deque
from dataclasses import dataclass
from types import SimpleNamespace
from typing import NamedTuple

from estimator.compiled import jit_compile
from estimator.structs import I64, Flag, Struct, StructArray
from teleop.config.ranges import RangedConfig, build_ranged_field
from teleop.link.reception import DRIFT, NEVER_NS, MessageCounts
from teleop.messages.messages import LinkReport
from teleop.messages.topics import Role
from teleop.runtime.clock import Durations, Percentiles
from teleop.session.state_machine import Reason, to_reason

WINDOW_NS = 1_000_000_000  # [ns] of the bounds of the offset, which drift apart in longer ones
SPAN_NS = 100_000_000  # [ns] between two decisions
LOSS_SPANS = 10  # spans of which losses are counted together
_UNBOUNDED_NS = 2**62
_DRIFT_NS = 2 * WINDOW_NS // DRIFT  # that bounds may contradict each other without a clock set


@dataclass(frozen=True, slots=True, kw_only=True)
class HealthConfig(RangedConfig):
    """Bounds of the link. Beyond one of them force and motion are scaled down, then held.

    The defaults leave a session over 300 ms +- 50 ms and with losses of a third as it is.
    """

    # from a message to the first one that echoes it
    round_trip: float = build_ranged_field(1.0, 1e-3, 10.0, "s")
    # mean difference of the delays of two messages in a row
    jitter: float = build_ranged_field(0.2, 1e-4, 10.0, "s")
    loss: float = build_ranged_field(0.5, 1e-3, 1.0)  # of the peer's messages in the last second
    # of force and motion, reached just before holding
    scale_min: float = build_ranged_field(0.3, 0.01, 1.0)
    # beyond a bound, while force and motion are scaled down
    hold_after: float = build_ranged_field(2.0, 0.1, 60.0, "s")
    # of each bound, below which the link is good again
    recover: float = build_ranged_field(0.8, 0.1, 1.0)
    recover_after: float = build_ranged_field(1.0, 0.0, 60.0, "s")  # below it


DEFAULT_BOUNDS = HealthConfig()


class LinkWindow(Struct):
    """What is known of the clocks, and the sums of the present span."""

    since_ns: I64 = 0  # when the present window began, 0 = none has
    low_ns: I64 = -_UNBOUNDED_NS  # bounds of the offset in it
    high_ns: I64 = _UNBOUNDED_NS
    low_before_ns: I64 = -_UNBOUNDED_NS  # in the one before
    high_before_ns: I64 = _UNBOUNDED_NS
    echo_ns: I64 = 0  # newest own stamp that the peer has echoed
    transit_ns: I64 = 0  # received less sent, of the last message
    has_transit: Flag = False
    clock_set: Flag = False  # bounds contradicted each other, since the last `take_measurement`
    steps: I64 = 0  # of the span: differences of delays
    step_sum_ns: I64 = 0
    answers: I64 = 0  # of the span: round trips
    answer_sum_ns: I64 = 0
    answer_max_ns: I64 = 0


_WINDOW_FIELDS = tuple(LinkWindow.dtype.names or ())
_SUMS = ("clock_set", "steps", "step_sum_ns", "answers", "answer_sum_ns", "answer_max_ns")
_REPORTED_SPANS = (  # of a measurement, in a LinkReport -1 where there was nothing to measure
    "uncertainty_ns", "round_trip_ns", "round_trip_max_ns", "jitter_ns", "delay_in_ns",
    "delay_out_ns",
)  # fmt: skip


class LinkCounts(NamedTuple):
    """Message counts of which the health of a link is found."""

    received: int = 0
    lost: int = 0
    repeated: int = 0
    out_of_order: int = 0


@jit_compile
def update_link_window(
    windows: StructArray, sent_ns: int, received_ns: int, echo_ns: int, hold_ns: int
) -> None:
    """Take one message of the peer.

    `windows` is a `LinkWindow`, shape (1,), changed in place; `sent_ns` is on the peer's clock,
    `received_ns` on ours; `echo_ns` is our newest stamp that the peer had, 0 = none, `hold_ns` how
    long it had it, 0 = unknown.
    """
    window = windows[0]
    if received_ns - window.since_ns > WINDOW_NS or received_ns < window.since_ns:
        window.low_before_ns, window.high_before_ns = window.low_ns, window.high_ns
        window.low_ns, window.high_ns = -_UNBOUNDED_NS, _UNBOUNDED_NS
        window.since_ns = received_ns
    transit_ns = received_ns - sent_ns
    if window.has_transit:
        window.steps += 1
        window.step_sum_ns += abs(transit_ns - window.transit_ns)
    window.transit_ns = transit_ns
    window.has_transit = True
    window.low_ns = max(window.low_ns, -transit_ns)
    if 0 < echo_ns <= received_ns:
        window.high_ns = min(window.high_ns, sent_ns - hold_ns - echo_ns)
        if echo_ns > window.echo_ns:
            round_trip_ns = max(received_ns - echo_ns - hold_ns, 0)
            window.answers += 1
            window.answer_sum_ns += round_trip_ns
            window.answer_max_ns = max(window.answer_max_ns, round_trip_ns)
    window.echo_ns = echo_ns
    low_ns = max(window.low_ns, window.low_before_ns)
    high_ns = min(window.high_ns, window.high_before_ns)
    if low_ns - high_ns > _DRIFT_NS:
        window.clock_set = True
        window.low_before_ns, window.high_before_ns = -_UNBOUNDED_NS, _UNBOUNDED_NS
        window.low_ns, window.high_ns = -transit_ns, _UNBOUNDED_NS
        window.since_ns = received_ns


def compile_link_window_update() -> None:
    """Compile `update_link_window`, before a loop has to be on time."""
    update_link_window(LinkWindow.array(), 0, 0, 0, 0)


class LinkMeasurement(NamedTuple):
    """What was measured in a span; None where there was nothing to measure."""

    offset_ns: int | None = None  # the peer's clock less ours
    uncertainty_ns: int | None = None  # of it, certified
    round_trip_ns: int | None = None  # mean
    round_trip_max_ns: int | None = None
    jitter_ns: int | None = None
    delay_in_ns: int | None = None  # of the last message from the peer, by the offset
    delay_out_ns: int | None = None  # the rest of the round trip
    loss: float | None = None  # share in the last `LOSS_SPANS`
    repeated: int = 0  # in the span
    out_of_order: int = 0
    clock_set: bool = False  # a clock was set since the last span


class Decision(NamedTuple):
    """What follows from the health of the link."""

    reason: Reason = Reason.NONE  # the bound that is exceeded
    holds: bool = False  # hold: not scaled down, but held
    scale: float = 1.0  # of force and motion
    over_s: float = 0.0  # [s] beyond a bound, at most `hold_after`
    good_s: float = 0.0  # [s] below all bounds


_HEALTHY_DECISION = Decision()


def step(
    config: HealthConfig,
    previous: Decision,
    figures: LinkMeasurement,
    dt: float,
    peer: Reason = Reason.NONE,
) -> Decision:
    """Return what follows from the figures of a span.

    Beyond a bound the scale falls within `hold_after` to `scale_min`; then the session is held.
    Both end after `recover_after` below all bounds times `recover`, the scale as slowly as it fell;
    in between nothing changes.

    `dt` [s] is the length of the span, `peer` the bound that the peer finds exceeded, of what it
    receives.
    """
    reasons = _find_exceeded_bounds(config, figures, 1.0)
    if peer in REASONS:
        reasons.append(peer)
    if reasons:
        over_s = min(previous.over_s + dt, config.hold_after)
        return _build_decision(config, reasons[0], previous.holds, over_s, 0.0)
    if _find_exceeded_bounds(config, figures, config.recover):
        return previous._replace(good_s=0.0)
    if previous.reason is Reason.NONE and not previous.over_s:
        return _HEALTHY_DECISION
    good_s = previous.good_s + dt
    if good_s < config.recover_after:
        return previous._replace(good_s=good_s)
    return _build_decision(config, Reason.NONE, False, max(0.0, previous.over_s - dt), good_s)


REASONS = (Reason.LINK_SLOW, Reason.LINK_JITTER, Reason.LINK_LOSS)


def _build_decision(
    config: HealthConfig, reason: Reason, holds: bool, over_s: float, good_s: float
) -> Decision:
    scale = 1.0 - (1.0 - config.scale_min) * over_s / config.hold_after
    holds = reason is not Reason.NONE and (holds or over_s >= config.hold_after - 1e-9)
    return Decision(reason, holds, scale, over_s, good_s)


def _find_exceeded_bounds(
    config: HealthConfig, figures: LinkMeasurement, share: float
) -> list[Reason]:
    """Return the bounds that are exceeded, the worst first."""
    pairs = (
        (Reason.LINK_SLOW, figures.round_trip_ns, config.round_trip * 1e9),
        (Reason.LINK_JITTER, figures.jitter_ns, config.jitter * 1e9),
        (Reason.LINK_LOSS, figures.loss, config.loss),
    )
    excess = [
        (value / (share * bound), reason)
        for reason, value, bound in pairs
        if value is not None and value > share * bound
    ]
    return [reason for _, reason in sorted(excess, reverse=True)]


@dataclass(frozen=True, slots=True)
class LinkSummary:
    """Figures of a side's link over a whole run."""

    round_trip_ms: Percentiles
    jitter_ms: Percentiles
    offset_ms: float | None  # of the peer's clock; None = not known
    uncertainty_ms: float | None  # of the offset
    loss: float  # fraction of the peer's messages
    repeated: int
    out_of_order: int
    clock_jumps: int
    scaled_s: float  # [s] with force and motion scaled down
    held_s: float  # [s] in which the session held


class LinkHealth:
    """Health of one side's link: the window, the counts of the last second, the decision.

    `windows` is a `LinkWindow`, shape (1,), for `update_link_window`; `figures` and `decision` are
    those of the last span.
    """

    def __init__(self, config: HealthConfig) -> None:
        self.windows = LinkWindow.array()
        self.figures, self.decision = LinkMeasurement(), Decision()
        self.round_trip, self.jitter = Durations(), Durations()  # means of spans, of the whole run
        self.scaled_s = self.held_s = 0.0  # [s] in which force and motion were scaled, held
        self._config, self._due_ns = config, 0
        self._counts: deque[LinkCounts] = deque(maxlen=LOSS_SPANS + 1)

    def is_due(self, now_ns: int) -> bool:
        """Return whether a span ends at `now_ns` [ns]."""
        return now_ns >= self._due_ns

    def update(self, now_ns: int, counts: MessageCounts, peer: Reason = Reason.NONE) -> bool:
        """End a span; return whether the decision has changed. See `step`."""
        dt = SPAN_NS * 1e-9 if self._due_ns else 0.0
        self._due_ns = now_ns + SPAN_NS
        present = LinkCounts(counts.received, counts.lost, counts.repeated, counts.out_of_order)
        self._counts.append(present)
        self.figures = take_measurement(self.windows, self._counts[0], present)
        previous = self.decision
        self.decision = step(self._config, self.decision, self.figures, dt, peer)
        self._note(dt)
        return self.decision != previous

    def _note(self, dt: float) -> None:
        self.scaled_s += dt * (self.decision.scale < 1.0)
        self.held_s += dt * self.decision.holds
        for durations, value in (
            (self.round_trip, self.figures.round_trip_ns),
            (self.jitter, self.figures.jitter_ns),
        ):
            if value is not None:
                durations.add(value)

    def build_message(self, role: Role, counts: MessageCounts, age_ns: int) -> LinkReport:
        """Return the message of the present health; `age_ns` of the peer's newest message."""
        figures, decision = self.figures, self.decision
        spans = {name: getattr(figures, name) for name in _REPORTED_SPANS}
        return LinkReport(
            role=role,
            reason=decision.reason,
            holds=decision.holds,
            scale=decision.scale,
            offset_ns=figures.offset_ns or 0,
            **{name: -1 if span is None else span for name, span in spans.items()},
            age_ns=-1 if age_ns == NEVER_NS else age_ns,
            loss=-1.0 if figures.loss is None else figures.loss,
            repeated=counts.repeated,
            out_of_order=counts.out_of_order,
            clock_jumps=counts.clock_jumps,
        )

    def build_summary(self, counts: MessageCounts) -> LinkSummary:
        """Return the figures of the whole run."""
        offset_ns, uncertainty_ns = self.figures.offset_ns, self.figures.uncertainty_ns
        return LinkSummary(
            round_trip_ms=self.round_trip.compute_percentiles(1e-6),
            jitter_ms=self.jitter.compute_percentiles(1e-6),
            offset_ms=None if offset_ns is None else offset_ns * 1e-6,
            uncertainty_ms=None if uncertainty_ns is None else uncertainty_ns * 1e-6,
            loss=counts.lost / max(counts.lost + counts.received, 1),
            repeated=counts.repeated,
            out_of_order=counts.out_of_order,
            clock_jumps=counts.clock_jumps,
            scaled_s=self.scaled_s,
            held_s=self.held_s,
        )


def take_measurement(
    windows: StructArray, counts_before: LinkCounts, counts: LinkCounts
) -> LinkMeasurement:
    """Return the figures of the span of a `LinkWindow`, shape (1,), and begin a new one.

    The sums of the window are cleared; the counts are those of `LOSS_SPANS` ago and now.
    """
    # all at once: each field of a record takes microseconds
    window = SimpleNamespace(**dict(zip(_WINDOW_FIELDS, windows[0].item(), strict=True)))
    windows[list(_SUMS)] = (0,) * len(_SUMS)
    low_ns = max(window.low_ns, window.low_before_ns)
    high_ns = min(window.high_ns, window.high_before_ns)
    has_delay = low_ns > -_UNBOUNDED_NS and high_ns < _UNBOUNDED_NS
    round_trip_ns = window.answer_sum_ns // window.answers if window.answers else None
    offset_ns = (low_ns + high_ns) // 2 if has_delay else None
    delay_in_ns = None if offset_ns is None else max(window.transit_ns + offset_ns, 0)
    out_ns = None
    if round_trip_ns is not None and delay_in_ns is not None:
        out_ns = max(round_trip_ns - delay_in_ns, 0)
    # a message that is overtaken counts as lost first
    out_of_order = counts.out_of_order - counts_before.out_of_order
    lost = max(counts.lost - counts_before.lost - out_of_order, 0)
    sent = lost + counts.received - counts_before.received
    return LinkMeasurement(
        offset_ns=offset_ns,
        uncertainty_ns=max(high_ns - low_ns, 0) // 2 if has_delay else None,
        round_trip_ns=round_trip_ns,
        round_trip_max_ns=window.answer_max_ns if window.answers else None,
        jitter_ns=window.step_sum_ns // window.steps if window.steps else None,
        delay_in_ns=delay_in_ns,
        delay_out_ns=out_ns,
        loss=lost / sent if sent else None,
        repeated=counts.repeated - counts_before.repeated,
        out_of_order=out_of_order,
        clock_set=window.clock_set,
    )


def format_link_health(link: LinkReport) -> str:
    """Return the health of a link in words: `link 0.5 ms +- 0.1, loss 0 %`."""
    if link.round_trip_ns < 0:
        text = "link -"
    else:
        jitter = "" if link.jitter_ns < 0 else f" +- {link.jitter_ns * 1e-6:.1f}"
        text = f"link {link.round_trip_ns * 1e-6:.1f}{jitter} ms"
    if link.loss > 0.0:
        text += f", loss {100 * link.loss:.1f} %"
    if link.reason:
        effect = "held" if link.holds else f"scaled to {100 * link.scale:.0f} %"
        text += f": {to_reason(link.reason).text}, {effect}"
    return text
