"""What stands in for the link of a side whose process is driven tick by tick."""

from contextlib import nullcontext

from teleop.errors import PeerError
from teleop.link import LatestMessage, ReceivedMessage
from teleop.link.rate_limit import RefusalCounter
from teleop.messages.messages import NO_TOPICS, decode_text
from teleop.messages.topics import EVENT, SETTING, STOP
from teleop.runtime.clock import now_ns

ON_THE_WAY = 1e-5  # [s]


class FakeLink:
    """Keeps what is published; a side's own tests say what its peer sends in `latest` and `wait`.

    Its messages take `ON_THE_WAY` in `clock`.
    """

    nonce, clock = 5, None
    is_present = skip_unsubscribed = staticmethod(lambda *_: False)
    count_refused = count_forged = staticmethod(lambda _topic: 0)
    list_last_sequences = staticmethod(lambda: NO_TOPICS)

    def __init__(self, topic, limit_ns):
        self.sent, self.heard, self.refusals = [], [], RefusalCounter()
        self.topic, self.limit_ns = topic, limit_ns
        self.received = LatestMessage(topic, lambda _: True)
        self.sequence, self.conflict = 0, None
        self.stamps = []  # [ns] of what the peer has sent

    def publish(self, topic, message):
        stamp = now_ns()
        self.sent.append((topic, message))
        return stamp

    def publish_packet(self, topic, packet):
        stamp = now_ns()
        message = topic.message.unpack(packet.seal(self.nonce, len(self.sent) + 1, stamp))
        self.sent.append((topic, message))
        return stamp

    def subscribe_latest(self, topic, limit_ns):
        assert (topic, limit_ns) == (self.topic, self.limit_ns)
        return self.received

    def take(self, messages):
        """Let messages of the peer arrive."""
        arrived = []
        for message in messages:
            self.sequence += 1
            self.stamps.append(now_ns())
            data = message.pack(self.nonce, self.sequence, self.stamps[-1])
            arrived.append((data, now_ns()))
        self.received.take(arrived)
        self.clock.sleep(ON_THE_WAY)
        return self.received

    def listen(self, topics):
        assert set(topics) == {STOP, SETTING}
        return self

    def drain(self):
        heard, self.heard = self.heard, []
        return heard

    def is_announced(self, nonce):
        return nonce == 77

    def has_right(self, nonce, right):
        return right == "stop" or self.is_announced(nonce)

    def count_messages(self):
        return self.received.counts

    def check_peers(self):
        if self.conflict:
            raise PeerError(self.conflict)

    def of(self, topic):
        return [message for which, message in self.sent if which is topic]

    def said(self):
        return [decode_text(event.text) for event in self.of(EVENT)]


def receive(topic, message, sequence=1, sender=77):
    """Return what a link hands over of a message from another process."""
    data = message.pack(sender, sequence, now_ns())
    return ReceivedMessage(topic, data, now_ns(), sender, sequence, now_ns())


class Until:
    """Stops after a number of ticks, or when asked to."""

    allow_interrupt = nullcontext

    def __init__(self, ticks):
        self.left, self.reason = ticks, ""

    def __call__(self):
        self.left -= 1
        return self.left < 0 or bool(self.reason)

    def request(self, reason):
        self.reason = self.reason or reason
