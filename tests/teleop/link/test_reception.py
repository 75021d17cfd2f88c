"""The bookkeeping of arrivals: what is let in, what is counted, how old it is."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.link import NEVER_NS, LatestMessage
from teleop.link.reception import DRIFT, Reception
from teleop.messages.messages import Command
from teleop.messages.topics import COMMAND
from tests.teleop.link.bench import MS, packed


def take(latest, data, now_ns):
    """Take in messages that have all come at the same time."""
    latest.take([(item, now_ns) for item in data])


def total(counts):
    return counts.received + counts.rejected


@given(st.lists(st.integers(1, 40), max_size=60), st.randoms(use_true_random=False))
def test_every_arrival_is_counted_once_and_what_is_let_in_only_ever_gets_newer(sequences, chance):
    reception = Reception(COMMAND, visit=lambda nonce: nonce == 7)
    admitted, damaged = [], 0
    for sequence in sequences:
        data = packed(sequence)
        if chance.random() < 0.2:
            position = chance.randrange(len(data))
            data = data[:position] + bytes([data[position] ^ 0x10]) + data[position + 1 :]
            damaged += 1
        head = reception.admit(data)
        if head is not None:
            admitted.append(head.sequence)
    counts = reception.counts
    assert admitted == sorted(set(admitted))
    assert total(counts) == len(sequences)
    assert counts.corrupted + counts.layout == damaged
    if admitted:
        missing = set(range(admitted[0], admitted[-1])) - set(admitted)
        assert counts.lost == len(missing)


def test_a_gap_behind_a_full_channel_is_overwritten_not_lost():
    reception = Reception(COMMAND, visit=lambda _: True)
    reception.admit(packed(1))
    reception.admit(packed(5), overflowed=True)
    reception.admit(packed(8))
    assert (reception.counts.overwritten, reception.counts.lost) == (3, 2)


def test_no_message_is_older_than_any_limit():
    latest = LatestMessage(COMMAND, visit=lambda _: True)
    assert latest.compute_age_ns(0) == NEVER_NS
    assert not latest.is_fresh(0, 10**18)
    take(latest, [], 5)
    assert not latest.new


@pytest.mark.parametrize("offset_ns", [0, -5_000_000_000_000, 123_456_789])
def test_age_is_time_since_sent_less_the_quickest_way_whatever_the_clocks_say(offset_ns):
    """Against a simulated wire on which the true age of every message is known."""
    chance = random.Random(1)  # noqa: S311 - a wire, not a secret
    latest = LatestMessage(COMMAND, visit=lambda _: True)
    quickest = 200_000
    in_flight = []  # (arrives, sent), on our clock
    newest_sent = None
    for tick in range(3000):
        now = tick * MS
        stalled = 1000 <= tick < 1300
        delay = quickest + int(chance.expovariate(1e-5)) + (1300 - tick) * MS * stalled
        in_flight.append((now + delay, now))
        arrived = sorted(m for m in in_flight if m[0] <= now)
        in_flight = [m for m in in_flight if m[0] > now]
        data = [packed(sent // MS + 1, stamp_ns=sent + offset_ns) for _, sent in arrived]
        take(latest, sorted(data, key=lambda d: Command.unpack(d).sequence), now)
        if arrived:
            newest_sent = max([newest_sent or 0, *(sent for _, sent in arrived)])
        if tick > 100 and newest_sent is not None:
            truth = now - newest_sent
            age = latest.compute_age_ns(now)
            slack = 3 * MS + 300 * MS // DRIFT  # one poll, the quickest way, the drift of a stall
            assert truth - slack <= age <= truth + slack


def test_the_clocks_of_a_restarted_sender_are_learnt_anew():
    there = {7}
    latest = LatestMessage(COMMAND, visit=lambda nonce: nonce in there)
    take(latest, [packed(1, sender=7, stamp_ns=10**15)], 0)
    there.symmetric_difference_update({7, 9})
    take(latest, [packed(1, sender=9, stamp_ns=0)], 10 * MS)
    assert latest.compute_age_ns(10 * MS) == 0


@pytest.mark.parametrize("gain", [0.0005, -0.0005])
def test_clocks_that_run_at_different_speeds_do_not_make_messages_old(gain):
    """The most that NTP slews, for ten minutes: 0.3 s between the clocks in the end."""
    latest = LatestMessage(COMMAND, visit=lambda _: 1)
    for k in range(6_000):
        now = k * 100 * MS
        data = packed(k + 1, stamp_ns=round(now * (1.0 - gain)))
        take(latest, [data], now)
        assert latest.is_fresh(now, 1 * MS)


def test_a_peer_that_slept_is_fresh_again_once_its_token_has_come_back():
    visit = {7: 1}
    latest = LatestMessage(COMMAND, visit=lambda nonce: visit[nonce])
    slept = 10_000 * MS
    take(latest, [packed(1, stamp_ns=0)], 0)
    visit[7] = 0
    take(latest, [packed(2, stamp_ns=MS)], slept)
    assert not latest.is_fresh(slept, 9_000 * MS)  # until then it is taken for held up
    visit[7] = 2
    for k in range(3, 10):
        now = slept + k * MS
        take(latest, [packed(k, stamp_ns=k * MS)], now)
        assert latest.is_fresh(now, MS)
    take(latest, [packed(10, stamp_ns=10 * MS)], slept + 510 * MS)
    assert not latest.is_fresh(slept + 510 * MS, 400 * MS)  # what is held up is old as before
