"""Messages that were sent but are not in a recording, counted from their sequence numbers."""

from collections import OrderedDict

SENDERS = 64  # senders tracked per topic; beyond that the least recent one is dropped
DROPPED_SENDER = 0  # stands for dropped senders


class GapCounter:
    """Lost messages per topic and sender.

    Each sender numbers the messages of a topic 0, 1, 2, ..., and the link delivers them in rising
    order; a skipped number is a lost message. Messages before the first or after the last received
    one are not counted, unless `note_sent` says that there were some after it: these are counted by
    `finish`. A restarted process is a new sender, not a gap. Losses of dropped senders are summed
    under `DROPPED_SENDER`.
    """

    def __init__(self) -> None:
        self.lost: dict[tuple[str, int], int] = {}  # (topic, sender) -> messages
        self._sent: dict[tuple[str, int], int] = {}  # the sender's own count
        self._next: dict[str, OrderedDict[int, int]] = {}  # topic -> sender -> number, oldest first

    def note(self, topic: str, sender: int, sequence: int) -> None:
        """Add one message."""
        stream, senders = (topic, sender), self._next.setdefault(topic, OrderedDict())
        expected = senders.get(sender, sequence)
        self.lost[stream] = self.lost.get(stream, 0) + max(0, sequence - expected)
        senders[sender] = max(expected, sequence + 1)
        senders.move_to_end(sender)
        if len(senders) > SENDERS:
            oldest, _ = senders.popitem(last=False)
            forgotten = topic, DROPPED_SENDER
            lost = self.lost.pop((topic, oldest), 0)
            self._sent.pop((topic, oldest), None)
            self.lost[forgotten] = self.lost.get(forgotten, 0) + lost

    def note_sent(self, topic: str, sender: int, sequence: int) -> None:
        """Note that a sender says that `sequence` is its last message of a topic so far.

        Ignored while no message of them was received: the recording begins with the first.
        """
        if sender in self._next.get(topic, ()):
            self._sent[topic, sender] = max(sequence, self._sent.get((topic, sender), 0))

    def finish(self) -> None:
        """Count as lost what senders sent after the last message received; once, at the end."""
        for (topic, sender), sequence in self._sent.items():
            expected = self._next[topic][sender]
            self.lost[topic, sender] += max(0, sequence + 1 - expected)
        self._sent.clear()

    @property
    def total(self) -> int:
        """Lost messages of all topics and senders."""
        return sum(self.lost.values())

    def by_topic(self) -> dict[str, int]:
        """Return lost messages per topic, senders taken together."""
        topics: dict[str, int] = {}
        for (topic, _), count in self.lost.items():
            topics[topic] = topics.get(topic, 0) + count
        return topics
