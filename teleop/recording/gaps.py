"""Messages that were sent but never arrived, counted from their sequence numbers."""


class Gaps:
    """Lost messages per topic and sender.

    Each sender numbers the messages of a topic 0, 1, 2, ..., and the link hands them on in rising
    order; a number that is skipped is a lost message. What a sender sent before the first or after
    the last message heard cannot be known and is not counted. A restarted process is a new sender,
    not a gap.
    """

    def __init__(self) -> None:
        self.lost: dict[tuple[str, int], int] = {}  # (topic, sender) -> messages
        self._next: dict[tuple[str, int], int] = {}

    def note(self, topic: str, sender: int, sequence: int) -> None:
        """Take one message into account."""
        stream = topic, sender
        expected = self._next.get(stream, sequence)
        self.lost[stream] = self.lost.get(stream, 0) + max(0, sequence - expected)
        self._next[stream] = max(expected, sequence + 1)

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
