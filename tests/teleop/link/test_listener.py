"""Queues of raw messages and what listens through them: bounded, in order, counted exactly."""

import threading
import tracemalloc
from dataclasses import replace
from unittest.mock import patch

from hypothesis import given
from hypothesis import strategies as st

from teleop.link import MessageCounts, listener
from teleop.link.listener import CAPACITY_MIN, Listener, MessageQueue, compute_capacity
from teleop.messages.messages import EmergencyStop
from teleop.messages.topics import COMMAND, EVENT, LEDGER, STATE, STOP
from tests.teleop.link.bench import packed
from tests.tick.memory_link import Sample


def hear(listener, topic):
    """Return what gives the listener the bytes of a message of `topic`."""
    store = listener.store(topic)
    return lambda data: store(Sample(data))


# --- the queue ------------------------------------------------------------------------------------


@given(
    st.integers(1, 8),
    st.integers(1, 8),
    st.lists(st.sampled_from(["command", "state", "take"]), max_size=80),
)
def test_what_is_put_is_taken_in_order_or_counted_as_dropped(commands, states, steps):
    """Against a plain list per topic of which the newest are kept."""
    capacity = {"command": commands, "state": states}
    topics = {"command": COMMAND, "state": STATE}
    queue = MessageQueue()
    for name, topic in topics.items():
        queue.add(topic, capacity[name])
    model = {name: [] for name in topics}
    put = dict.fromkeys(topics, 0)
    taken = dict.fromkeys(topics, 0)
    for k, step in enumerate([*steps, "take"]):
        if step != "take":
            queue.put(topics[step], str(k).encode(), k)
            model[step].append(str(k).encode())
            put[step] += 1
            continue
        arrivals, dropped = queue.take()
        assert [a.received_ns for a in arrivals] == sorted(a.received_ns for a in arrivals)
        for name, topic in topics.items():
            newest = model[name][-capacity[name] :]
            assert [a.data for a in arrivals if a.topic is topic] == newest
            taken[name] += len(newest)
            assert put[name] == taken[name] + dropped[name]
            assert dropped[name] == queue.count_dropped(topic)
            model[name] = []


def test_counts_are_exact_with_several_threads_putting_while_one_takes():
    queue, count, threads = MessageQueue(), 5000, 4
    queue.add(COMMAND, 50)
    queue.add(EVENT, 20)

    def fill(topic):
        for k in range(count):
            queue.put(topic, b"", k)

    workers = [threading.Thread(target=fill, args=(t,)) for t in (COMMAND, EVENT) * (threads // 2)]
    taken = {"command": 0, "event": 0}
    for worker in workers:
        worker.start()
    while any(worker.is_alive() for worker in workers):
        for arrival in queue.take()[0]:
            taken[arrival.topic.name] += 1
    for arrival in queue.take()[0]:
        taken[arrival.topic.name] += 1
    for topic in (COMMAND, EVENT):
        assert taken[topic.name] + queue.count_dropped(topic) == count * threads // 2


def test_a_flood_on_one_topic_displaces_nothing_of_another():
    queue = MessageQueue()
    queue.add(STOP)
    queue.add(EVENT)
    queue.put(STOP, b"stop", 0)
    for k in range(10 * compute_capacity(EVENT)):
        queue.put(EVENT, b"", k)
    arrivals, _ = queue.take()
    assert [a.data for a in arrivals if a.topic is STOP] == [b"stop"]
    assert len(arrivals) == 1 + compute_capacity(EVENT)


def test_memory_is_bounded_by_messages_of_the_size_of_the_topic_whatever_is_sent():
    listener = Listener(lambda *_: True)
    store = hear(listener, STOP)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for _ in range(2 * compute_capacity(STOP)):
        store(bytes(100_000))
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < compute_capacity(STOP) * (STOP.message.schema.size + 400)
    assert listener.drain() == []
    assert listener.count_messages(STOP) == MessageCounts(layout=compute_capacity(STOP))
    assert listener.count_dropped(STOP) == compute_capacity(STOP)


# --- the listener ---------------------------------------------------------------------------------


def test_a_listener_that_falls_behind_keeps_the_newest_and_counts_the_others():
    topic = replace(COMMAND, rate_hz=0)  # 256 messages
    listener = Listener(lambda *_: True)
    store = hear(listener, topic)
    store(packed(1))
    assert len(listener.drain()) == 1
    last = 2 * CAPACITY_MIN
    for k in range(2, last + 1):
        store(packed(k))
    kept = list(range(last - CAPACITY_MIN + 1, last + 1))
    assert [h.sequence for h in listener.drain()] == kept
    dropped = last - 1 - CAPACITY_MIN
    assert listener.count_dropped(topic) == dropped
    assert listener.count_messages(topic) == MessageCounts(
        received=1 + CAPACITY_MIN, overwritten=dropped
    )
    store(packed(last + 3))
    listener.drain()
    assert listener.count_messages(topic).lost == 2  # on the wire, as nothing was dropped since


@patch.object(listener, "CAPACITY_MIN", 8)
@given(st.lists(st.integers(0, 20), max_size=10), st.randoms(use_true_random=False))
def test_every_message_stored_is_heard_rejected_or_dropped(bursts, chance):
    topic = replace(LEDGER, rate_hz=0)
    listener = Listener(lambda *_: True)
    store = hear(listener, topic)
    sequences = dict.fromkeys(range(1, 4), 0)
    stored = heard = 0
    for burst in bursts:
        for _ in range(burst):
            sender = chance.randint(1, 3)
            sequences[sender] += 1
            data = LEDGER.message().pack(sender, sequences[sender], 0)
            store(data[:-1] if chance.random() < 0.1 else data)
            stored += 1
        heard += len(listener.drain())
    counts = listener.count_messages(topic)
    assert heard == counts.received
    assert stored == counts.received + counts.rejected + listener.count_dropped(topic)


def test_senders_without_end_take_no_memory_and_are_all_counted():
    listener = Listener(lambda *_: True)
    store, message = hear(listener, STOP), EmergencyStop()

    def flood(senders):
        for sender in senders:
            store(message.pack(sender, 1, 0))
            if sender % 100 == 0:
                listener.drain()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    before, after = flood(range(1, 2001)), flood(range(2001, 6001))
    tracemalloc.stop()
    assert after - before < 100_000
    assert listener.count_messages(STOP) == MessageCounts(received=6000)


def test_a_sender_that_goes_on_is_not_forgotten_for_a_flood_of_others():
    listener = Listener(lambda *_: True)
    store, message = hear(listener, STOP), EmergencyStop()
    for k in range(1, 1000):
        store(message.pack(7, 2 * k, 0))
        store(message.pack(1000 + k, 1, 0))
        store(message.pack(7, 2 * k, 0))
        assert len(listener.drain()) == 2
    counts = listener.count_messages(STOP)
    assert (counts.repeated, counts.lost) == (999, 998)
