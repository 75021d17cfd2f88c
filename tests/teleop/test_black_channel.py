"""The eight errors of a black channel (IEC 61784-3): each is detected, counted and harmless.

What is sent is a stream of commands of one sender, 1 kHz, over a line with 5 ms of delay. One error
is put into it. Then exactly its counter has moved, and no message of the error is acted upon.
"""

from dataclasses import asdict

import pytest

from teleop.link.reception import CLOCK_JUMP_NS, SETTLE_NS, LatestMessage
from teleop.messages.messages import Command, Hand, SlaveState
from teleop.messages.topics import COMMAND

MS = 1_000_000
OURS, ANOTHER = 7, 9
LIMIT = 30 * MS
DELAY = 5 * MS
BAD = 99  # the state that only a wrong message has


class CentreLine:
    """A receiver, and the wire to it: what is put on it, and what the receiver makes of it."""

    def __init__(self):
        self.there = {OURS}
        self.latest = LatestMessage(COMMAND, lambda nonce: int(nonce in self.there), LIMIT)
        self.now, self.sequence = 10**15, 0

    def message(self, state=1, sender=OURS, sequence=None, stamp=None):
        sequence = self.sequence if sequence is None else sequence
        stamp = self.now - DELAY if stamp is None else stamp
        return Command(state=state).pack(sender, sequence, stamp)

    def look(self, *arrived):
        self.latest.take([(data, self.now) for data in arrived])

    def tick(self, *before):
        """Let a millisecond pass, in which `before` and then the next message arrive."""
        self.now += MS
        self.sequence += 1
        self.look(*before, self.message())

    def run(self, ticks=20):
        for _ in range(ticks):
            self.tick()
        return self

    @property
    def acted_upon(self):
        fresh = self.latest.is_fresh(self.now, LIMIT)
        return self.latest.message.state if fresh and self.latest.message else None


def moved(before, after):
    return {name: after[name] - before[name] for name in after if after[name] != before[name]}


def counts(line):
    return asdict(line.latest.counts)


def test_a_line_in_order_moves_nothing_but_the_number_received():
    line = CentreLine().run(50)
    assert moved({}.fromkeys(counts(line), 0), counts(line)) == {"received": 50}
    assert line.acted_upon == 1


def corruption(line):
    data = bytearray(line.message(BAD, sequence=line.sequence + 1))
    data[60] ^= 0x40
    line.look(bytes(data))
    return {"corrupted": 1}


def repetition(line):
    line.look(line.message(BAD))
    return {"repeated": 1}


def wrong_sequence(line):
    line.look(line.message(BAD, sequence=line.sequence - 3))
    return {"out_of_order": 1}


def insertion(line):
    """A message of a process that nobody announced, before and after the peer is known."""
    fresh = CentreLine()
    fresh.look(fresh.message(BAD, sender=ANOTHER, sequence=1))
    assert fresh.latest.message is None
    assert fresh.latest.counts.unknown == 1
    line.look(line.message(BAD, sender=ANOTHER, sequence=line.sequence + 1))
    return {"foreign": 1}


def masquerade(line):
    """Another process that is announced in the peer's role while the peer is alive."""
    line.there.add(ANOTHER)
    line.look(line.message(BAD, sender=ANOTHER, sequence=line.sequence + 1))
    return {"foreign": 1}


@pytest.mark.parametrize("error", [corruption, repetition, wrong_sequence, insertion, masquerade])
def test_a_wrong_message_is_counted_and_never_acted_upon(error):
    line = CentreLine().run()
    before = counts(line)
    expected = error(line)
    assert moved(before, counts(line)) == expected
    assert line.acted_upon == 1  # the good one before it, which grows old from its own time on
    line.run(5)
    assert moved(before, counts(line)) == expected | {"received": 5}


@pytest.mark.parametrize("kind", [Hand, SlaveState])
def test_wrong_addressing_a_message_of_another_topic_is_none_of_ours(kind):
    line = CentreLine().run()
    before = counts(line)
    line.look(kind(state=BAD).pack(OURS, line.sequence + 1, line.now))
    assert moved(before, counts(line)) == {"layout": 1}
    assert line.acted_upon == 1


def test_wrong_addressing_a_message_of_another_session_has_a_sender_unknown_in_ours():
    line = CentreLine()
    line.look(line.message(BAD, sender=ANOTHER, sequence=5))
    assert moved({}.fromkeys(counts(line), 0), counts(line)) == {"unknown": 1}
    assert line.acted_upon is None


def test_a_loss_is_counted_and_its_silence_ends_what_is_acted_upon():
    line = CentreLine().run()
    before = counts(line)
    line.sequence += 12
    for _ in range(12):
        line.now += MS
        line.look()
    assert line.acted_upon == 1  # 12 ms are bridged
    line.tick()
    assert moved(before, counts(line)) == {"lost": 12, "received": 1}
    for _ in range(31):
        line.now += MS
        line.look()
    assert line.acted_upon is None


def test_a_delay_is_counted_and_a_message_that_has_one_is_not_acted_upon():
    line = CentreLine().run()
    before = counts(line)
    line.now += 31 * MS
    line.sequence += 1
    line.look(line.message(BAD, stamp=line.now - DELAY - 31 * MS))
    assert moved(before, counts(line)) == {"received": 1, "delayed": 1}
    assert line.acted_upon is None
    line.run(1)
    assert line.acted_upon == 1


def test_a_delay_that_grows_slowly_is_found_too():
    """A queue that fills: each message is a little later than the one before."""
    line = CentreLine().run(100)
    for k in range(1, 60):
        line.now += MS
        line.sequence += 1
        line.look(line.message(stamp=line.now - DELAY - k * MS))
        assert (line.acted_upon is None) == (k > 30)
    assert line.latest.counts.delayed == 29


@pytest.mark.parametrize("back", [2 * MS, 10**9, 10**15])
def test_a_clock_that_is_set_back_is_counted_and_held_for_and_learnt_anew(back):
    """Nothing is acted upon until it has settled; then a late message is late again."""
    line = CentreLine().run()
    before = counts(line)
    held = SETTLE_NS // MS
    for k in range(held + 5):
        line.now += MS
        line.sequence += 1
        line.look(line.message(stamp=line.now - DELAY - back))
        assert line.latest.settles == (k < held)
        assert (line.acted_upon is None) == (k < held)
    found = moved(before, counts(line))
    assert found == {"received": held + 5, "delayed": held, "clock_jumps": 1}
    line.now += 40 * MS
    line.sequence += 1
    line.look(line.message(BAD, stamp=line.now - DELAY - back - 35 * MS))
    assert line.acted_upon is None


def test_a_clock_set_back_while_messages_are_lost_is_learnt_anew_when_that_is_found_out():
    line = CentreLine().run()
    line.now += 1000 * MS  # of silence
    for k in range(50):
        line.now += MS
        line.sequence += 1
        line.look(line.message(stamp=line.now - DELAY - 500 * MS))
        assert line.acted_upon is None  # late, for all that its stamps can say
        if k == 20:
            line.latest.was_clock_set()
            assert line.acted_upon is None
    assert line.latest.counts.clock_jumps == 1
    for _ in range(SETTLE_NS // MS):
        line.now += MS
        line.sequence += 1
        line.look(line.message(stamp=line.now - DELAY - 500 * MS))
    assert line.acted_upon == 1


def test_a_clock_that_is_set_forward_is_counted_and_learnt_anew():
    line = CentreLine().run()
    before = counts(line)
    ahead = 2 * CLOCK_JUMP_NS
    for _ in range(5):
        line.now += MS
        line.sequence += 1
        line.look(line.message(stamp=line.now - DELAY + ahead))
        assert line.acted_upon == 1
    assert moved(before, counts(line)) == {"received": 5, "clock_jumps": 1}
    for _ in range(40):  # and silence is silence by our own clock
        line.now += MS
        line.look()
    assert line.acted_upon is None


def test_a_restarted_peer_is_taken_up_only_when_the_old_one_is_gone_and_is_counted():
    line = CentreLine().run()
    before = counts(line)
    line.there = {ANOTHER}
    line.look(line.message(2, sender=ANOTHER, sequence=1))
    assert moved(before, counts(line)) == {"received": 1, "restarts": 1}
    assert line.latest.message.sender == ANOTHER
    line.look(line.message(BAD, sender=OURS, sequence=10**6))  # the old one's last words
    assert line.latest.message.state == 2
    line.there = {OURS}  # or what somebody has kept of it
    line.look(line.message(BAD, sender=OURS, sequence=line.sequence))
    assert line.latest.counts.out_of_order == 1
    assert line.latest.message.state == 2
