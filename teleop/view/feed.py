"""Feed the scene: live from the link, or from a recording at full speed."""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

from teleop.link import ReceivedMessage
from teleop.messages.messages import MessageError
from teleop.messages.topics import PROFILE, TOPICS
from teleop.recording.reader import read_messages
from teleop.recording.scan import RecordingError
from teleop.runtime.clock import Grid
from teleop.runtime.process import StopCondition, send_heartbeat
from teleop.view.columns import AnyTopic, Rows, decode
from teleop.view.curves import CURVES
from teleop.view.sinks import Sink

# --- stretches the periods of the view so that it takes no more than its share of a processor
# So does a page that does not keep up: a browser that draws by software takes in a few dozen blocks
# with each of its two or three pictures a second, and would fall further behind without end.
#
# Each call and each row has its cost, so the rows drawn of a second become fewer by the same
# factor.


_SPAN_S = 1.0  # over which the share is measured
_RELAX_FACTOR = 0.8  # per span, of the stretch, while the share is well below the limit
_CALM_SHARE = 0.8  # of the limit: below it the periods may shrink again
_LATE_S, _CURRENT_S = 2.0, 1.0  # [s] a page is behind: stretched above, may relax below
_LATE_FACTOR = 1.25  # per span, of the stretch, while a page is late
_STRETCH_MAX = 10.0  # stretch at most: pieces of a loop must not look like gaps between two loops


class Pacing:
    """Factor of the periods of drawing and of rows, from the processor time used so far.

    Time is an argument, so live use and a test call the same code.

    `limit` is a share of one processor.
    """

    def __init__(self, limit: float) -> None:
        self.stretch = 1.0
        self._limit = limit
        self._since: tuple[float, float] | None = None  # [s] processor time, clock

    def update(self, processor_s: float, now_s: float, behind_s: float = 0.0) -> float:
        """Return the factor.

        `processor_s` and `now_s` [s] are the processor time of this process, and the clock;
        `behind_s` [s] is by how much the slowest page is behind what was sent.
        """
        if self._since is None:
            self._since = processor_s, now_s
        used_s, passed_s = processor_s - self._since[0], now_s - self._since[1]
        if passed_s >= _SPAN_S:
            self._since = processor_s, now_s
            share = used_s / passed_s
            if share > self._limit:
                self.stretch = min(self.stretch * min(share / self._limit, 2.0), _STRETCH_MAX)
            elif behind_s > _LATE_S:
                self.stretch = min(self.stretch * _LATE_FACTOR, _STRETCH_MAX)
            elif share < _CALM_SHARE * self._limit and behind_s < _CURRENT_S:
                self.stretch = max(1.0, self.stretch * _RELAX_FACTOR)
        return self.stretch


class BatchDisplay:
    """Receiver of batches: pictures often, curves less often, as each update is costly.

    This one shows nothing.
    """

    def draw_pictures(self, batches: Mapping[AnyTopic, Rows]) -> int:  # noqa: ARG002 - shows nothing
        """Update the scene; returns the number of rows shown."""
        return 0

    def draw_curves(self, batches: Mapping[AnyTopic, Rows]) -> int:  # noqa: ARG002 - shows nothing
        """Extend the curves; returns the number of rows shown."""
        return 0

    def stretch(self, factor: float) -> None:
        """Draw fewer rows of a batch, by this factor."""

    def show_silence(self, silent_ns: int) -> None:
        """Show that nothing has arrived for so long [ns]."""

    def show_end(self, what: str, silent_ns: int = 0) -> None:
        """Show that a session or recording ended so long [ns] after its last data, no forces."""


_SILENT_NS = 1_000_000_000  # [ns] without a message after which what is shown is called old
_PROBE_EVERY_NS = 500_000_000
_CURVE_TOPICS = {*CURVES, PROFILE}  # shown by `Show.curves`
_BY_NAME = {topic.name: topic for topic in TOPICS}


@dataclass(slots=True)
class FeedCounts:
    """Counts for the summary."""

    received: int = 0
    shown: int = 0
    fault: str = ""  # reason of a failure


class MessageBuffer:
    """Messages buffered for a period, as every block has a fixed cost.

    Between two blocks there are `period_s` [s], between two calls of `take` `tick_s` [s]: a block
    may come half of it early, as the calls jitter.
    """

    def __init__(self, period_s: float, tick_s: float = 0.0) -> None:
        self._period_ns = round(period_s * 1e9)
        self._early_ns = round(tick_s * 0.5e9)
        self.stretch = 1.0  # factor of the period
        self._held: list[tuple[AnyTopic, bytes]] = []
        self._due_ns: int | None = None

    def add(self, messages: Iterable[tuple[AnyTopic, bytes]]) -> None:
        """Add messages."""
        self._held.extend(messages)

    def take(self, now_ns: int, all_of_it: bool = False) -> list[tuple[AnyTopic, bytes]]:
        """Return the buffer if its period is over or with `all_of_it`, else nothing."""
        if self._due_ns is None:
            self._due_ns = now_ns + self._period_ns - self._early_ns
        if now_ns < self._due_ns and not all_of_it:
            return []
        self._due_ns = now_ns + round(self._period_ns * self.stretch) - self._early_ns
        block, self._held = self._held, []
        return block


def show_session(
    drain: Callable[[], list[ReceivedMessage]],
    show: BatchDisplay,
    sink: Sink,
    stop: StopCondition,
    drain_hz: float,
    periods_s: tuple[float, float],
    processor_share: float = math.inf,
    has_ended: Callable[[], bool] = lambda: False,
) -> FeedCounts:
    """Show received messages until stopped.

    `drain` returns the messages since the last call, as `Listener.drain`; called at `drain_hz`.
    `periods_s` are between updates of the scene, and of the curves; stretched, and rows thinned by
    the same factor, where they would take more than `processor_share`, of one processor, or where a
    page does not keep up. `has_ended`: whether neither side of the session is there; asked when
    nothing arrives, and at the end.
    """
    fed = FeedCounts()
    pictures, curves = (MessageBuffer(period_s, 1.0 / drain_hz) for period_s in periods_s)
    pacing = Pacing(processor_share)

    def pass_on(now_ns: int, all_of_it: bool) -> None:
        for held, draw in ((pictures, show.draw_pictures), (curves, show.draw_curves)):
            block = held.take(now_ns, all_of_it)
            if block:
                fed.shown += draw(decode(block))

    probe_ns = received_ns = 0
    for tick in Grid(drain_hz, stop):
        messages = [(h.topic, h.data) for h in drain()]
        fed.received += len(messages)
        received_ns = tick.stamp_ns if messages or not received_ns else received_ns
        silent_ns = tick.stamp_ns - received_ns
        if silent_ns > _SILENT_NS and fed.received and has_ended():
            show.show_end("session", silent_ns)
        elif silent_ns > _SILENT_NS:
            show.show_silence(silent_ns)
        curves.add(m for m in messages if m[0] in _CURVE_TOPICS)
        pictures.add(messages)
        if not sink.is_alive():
            stop.request("the window was closed")
            continue
        factor = pacing.update(time.process_time(), time.monotonic(), sink.behind_s)
        pictures.stretch = curves.stretch = factor
        show.stretch(factor)
        pass_on(tick.stamp_ns, all_of_it=False)
        sink.publish()
        if tick.stamp_ns >= probe_ns:
            probe_ns = tick.stamp_ns + _PROBE_EVERY_NS
            send_heartbeat()
            if sink.is_stuck():
                fed.fault = "the window accepts no more data"
                stop.request("the viewer is stuck")
    if sink.is_alive() and not fed.fault:
        pass_on(0, all_of_it=True)
        if fed.received and has_ended():
            sink.ended = "The session has ended."
            show.show_end("session")
    return fed


def show_recording(
    path: str,
    show: BatchDisplay,
    stop: Callable[[], bool],
    period_s: float,
    publish: Callable[[], None] = lambda: None,
) -> FeedCounts:
    """Show a whole recording, a block of `period_s` [s] at a time; each is published."""
    fed = FeedCounts()
    for block in _read_blocks(path, round(period_s * 1e9)):
        if stop():
            break
        fed.received += len(block)
        try:
            batches = decode(block)
        except MessageError as error:
            raise RecordingError(
                f"{path}: {error}; view it with the version that recorded it"
            ) from error
        fed.shown += show.draw_pictures(batches) + show.draw_curves(batches)
        publish()
    else:
        show.show_end("recording")
        publish()
    return fed


def _read_blocks(path: str, period_ns: int) -> Iterator[list[tuple[AnyTopic, bytes]]]:
    block: list[tuple[AnyTopic, bytes]] = []
    end = 0
    for message in read_messages(path, _BY_NAME.keys()):
        if block and message.log_time_ns >= end:
            yield block
            block = []
        if not block:
            end = message.log_time_ns + period_ns
        block.append((_BY_NAME[message.topic], message.data))
    if block:
        yield block
