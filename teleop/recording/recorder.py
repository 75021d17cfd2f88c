"""What a recorder does: take messages, write them, know how far behind it is and what is missing.

Its work is one step, repeated; the clock is an argument.
"""

from collections import OrderedDict
from collections.abc import Callable

from teleop.link import Listener
from teleop.messages.messages import LoopReport
from teleop.messages.topics import REPORT, TOPICS, Role, format_role
from teleop.recording.writer import RecordingWriter

BATCH = 500  # messages of one step; none arrives meanwhile, and they are in memory twice
SILENCE_NS = 1_000_000_000  # without a message at the end: what has not come by then does not come
GRACE_NS = 500_000_000  # at the end, for what is under way from a session that goes on
SENDERS = 64  # whose reports are remembered


class Recorder:
    """Writes what a source has, batch by batch.

    The writer is closed by its owner; `is_present` returns whether the process with a nonce is
    present in a role. `lag_ns` [ns] is how long the oldest message not yet written has waited, as
    of the last `step`.
    """

    def __init__(
        self, source: Listener, writer: RecordingWriter, is_present: Callable[[Role, int], bool]
    ) -> None:
        self.lag_ns = 0
        self._source, self._writer, self._is_present = source, writer, is_present
        self._reports: OrderedDict[int, LoopReport] = OrderedDict()  # the newest of each sender
        self._moved_ns = 0  # when the last message was taken

    def step(self, clock: Callable[[], int]) -> int:
        """Write at most `BATCH` messages; return how many."""
        source, writer = self._source, self._writer
        oldest_ns = source.find_oldest_ns()
        messages = source.drain(BATCH)
        writer.note_dropped({topic.name: source.count_dropped(topic) for topic in TOPICS})
        writer.write(messages, clock())
        for item in messages:
            if item.topic is REPORT:
                self._note_report(item.sender, LoopReport.unpack(item.data))
        now = clock()
        if messages:
            self._moved_ns = now
        if oldest_ns is not None:  # until what was taken is written
            writer.lag_max_s = max(writer.lag_max_s, (now - oldest_ns) * 1e-9)
        waiting_ns = source.find_oldest_ns()
        self.lag_ns = 0 if waiting_ns is None else max(0, now - waiting_ns)
        return len(messages)

    def is_done(self, stop_ns: int, now_ns: int, grace_ns: int = GRACE_NS) -> bool:
        """Return whether everything is written that counts, if told to stop at `stop_ns`.

        That is once each side has said how much it sent, which is the last that it does. Of a side
        that left without a word, once nothing came for `SILENCE_NS`; of one that goes on, what came
        until `grace_ns` after `stop_ns`.
        """
        oldest_ns = self._source.find_oldest_ns()
        end_ns = stop_ns + grace_ns
        if oldest_ns is not None and oldest_ns <= end_ns:
            return False
        if all(report.ended for report in self._reports.values()):
            return oldest_ns is None
        goes_on = any(self._is_there(sender, report) for sender, report in self._reports.items())
        return now_ns > (end_ns if goes_on else max(self._moved_ns, stop_ns) + SILENCE_NS)

    def list_unfinished(self) -> list[str]:
        """Return the roles of senders that are gone, but have not said how much they sent."""
        return [
            format_role(report.role)
            for sender, report in self._reports.items()
            if not report.ended and not self._is_there(sender, report)
        ]

    def _is_there(self, sender: int, report: LoopReport) -> bool:
        return report.role in tuple(Role) and self._is_present(Role(report.role), sender)

    def finish(self) -> int:
        """Count what is missing at the end too; return the number of missing messages.

        Called when `is_done`, before the writer is closed.
        """
        self._writer.unfinished = tuple(self.list_unfinished())
        self._writer.gaps.finish()
        return self._writer.gaps.total

    def _note_report(self, sender: int, report: LoopReport) -> None:
        self._reports[sender] = report
        self._reports.move_to_end(sender)
        if len(self._reports) > SENDERS:
            self._reports.popitem(last=False)
        for topic, sequence in zip(TOPICS, report.sent, strict=False):
            self._writer.gaps.note_sent(topic.name, sender, sequence)
