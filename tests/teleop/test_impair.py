"""The proxy between the sides: its decisions as a pure function, and its process on loopback."""

import argparse
import json
import math
import os
import subprocess
import sys
import time
import unittest.mock
import uuid

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from studies.testbed.processes import find_free_ports, wait_for_condition
from teleop.config.loading import ConfigDocument
from teleop.errors import TeleopError, UsageError
from teleop.impair import command, model
from teleop.impair.config import DirectionConfig, ImpairConfig
from teleop.impair.direction import ENTRY_BYTES, DelayQueue, Direction
from teleop.impair.model import DeliveryFlags, StreamState
from teleop.link import Link, LinkConfig
from teleop.link.bridge import send_request
from teleop.messages.messages import Command, Event, MessageError, SlaveState, encode_text
from teleop.messages.topics import COMMAND, EVENT, STATE, Role
from teleop.runtime.clock import now_ns
from teleop.runtime.process import SUPERVISED_VARIABLE

KEY = model.compute_key(1, "to_slave", "command")
PERIOD_S = 1e-3


def passed_on(config, count=1000, key=KEY, cut=lambda _: False):
    """Send `count` numbered messages through a way; return deliveries (number, due) and fates."""
    memory, out, fates = StreamState(), [], []
    for number in range(count):
        data = number.to_bytes(4, "little")
        deliveries, fate, memory = model.step(
            config, key, memory, number * PERIOD_S, data, cut(number)
        )
        out += [(number, delivery.due, delivery.data) for delivery in deliveries]
        fates.append(fate)
    return out, fates


shares = st.floats(0.0, 1.0)
ways = st.builds(
    lambda delay, jitter, **others: DirectionConfig(delay=delay, jitter=jitter * delay, **others),
    delay=st.floats(0.0, 0.3),
    jitter=shares,
    jitter_time=st.sampled_from([0.0, 0.01, 0.1]),
    loss=shares,
    burst_loss=st.floats(0.0, 0.5),
    burst_length=st.floats(1.0, 100.0),
    reorder=shares,
    reorder_by=st.floats(0.0, 0.01),
    duplicate=shares,
    corrupt=shares,
)


# --- decisions ------------------------------------------------------------------------------------


def test_a_clean_way_passes_everything_on_at_once():
    out, fates = passed_on(DirectionConfig())
    assert [number for number, _, _ in out] == list(range(1000))
    assert all(due == number * PERIOD_S for number, due, _ in out)
    assert set(fates) == {DeliveryFlags.PASSED}


@given(ways, st.integers(0, 2**64 - 1))
def test_the_same_key_gives_the_same_fates_and_another_key_others(config, key):
    assert passed_on(config, 50, key) == passed_on(config, 50, key)
    lossy = DirectionConfig(loss=0.5)
    assert passed_on(lossy, 200, key)[1] != passed_on(lossy, 200, key ^ 1)[1]


@given(ways)
def test_no_message_leaves_before_its_time_or_after_its_latest(config):
    out, fates = passed_on(config, 200)
    least, most = config.delay - config.jitter, config.delay + config.jitter
    for number, due, _ in out:
        late = (
            due - number * PERIOD_S - config.reorder_by * (DeliveryFlags.HELD_BACK in fates[number])
        )
        assert least - 1e-9 <= late <= most + 1e-9


@given(ways)
def test_messages_change_places_only_where_they_are_held_back(config):
    out, fates = passed_on(config, 200)
    in_turn = [due for number, due, _ in out if DeliveryFlags.HELD_BACK not in fates[number]]
    assert in_turn == sorted(in_turn)


@given(ways)
def test_what_is_told_of_a_message_is_what_was_done_to_it(config):
    out, fates = passed_on(config, 200)
    copies = dict.fromkeys(range(200), 0)
    for number, _, data in out:
        copies[number] += 1
        changed = sum(a != b for a, b in zip(data, number.to_bytes(4, "little"), strict=True))
        assert changed == (DeliveryFlags.CORRUPTED in fates[number])
    gone = DeliveryFlags.LOST | DeliveryFlags.LOST_IN_BURST | DeliveryFlags.CUT
    for number, fate in enumerate(fates):
        assert copies[number] == (0 if fate & gone else 1 + (DeliveryFlags.DUPLICATED in fate))


@pytest.mark.parametrize(
    ("name", "kind", "share"),
    [
        ("loss", DeliveryFlags.LOST, 0.1),
        ("reorder", DeliveryFlags.HELD_BACK, 0.5),
        ("duplicate", DeliveryFlags.DUPLICATED, 0.01),
        ("corrupt", DeliveryFlags.CORRUPTED, 0.1),
    ],
)
def test_as_many_are_met_as_was_asked_for(name, kind, share):
    n = 10_000
    met = np.array([kind in fate for fate in passed_on(DirectionConfig(**{name: share}), n)[1]])
    sigma = math.sqrt(share * (1 - share) / n)
    assert abs(met.mean() - share) < 4 * sigma
    runs = np.count_nonzero(met[1:] & met[:-1]) / n  # each by itself: pairs are as rare as that
    assert abs(runs - share**2) < 5 * share * math.sqrt(1.0 / n)


@pytest.mark.parametrize(("length", "depth"), [(5.0, 1.0), (50.0, 0.5)])
def test_bursts_lose_their_share_and_last_as_long_as_asked_for(length, depth):
    n, share = 50_000, 0.1
    config = DirectionConfig(burst_loss=share, burst_length=length, burst_depth=depth)
    lost = np.array([DeliveryFlags.LOST_IN_BURST in fate for fate in passed_on(config, n)[1]])
    bursts = n * share / depth / length
    assert abs(lost.mean() - share) < 5 * share * math.sqrt(2.0 / bursts)
    if depth == 1.0:
        edges = np.flatnonzero(np.diff(np.concatenate([[0], lost, [0]])))
        assert np.mean(edges[1::2] - edges[::2]) == pytest.approx(length, rel=0.15)


def test_cuts_are_where_the_clock_says_and_go_round():
    config = DirectionConfig(cuts=((0.1, 0.2),), cut_period=0.5)
    _, fates = passed_on(config, 1000)
    cut = [number for number, fate in enumerate(fates) if fate == DeliveryFlags.CUT]
    assert {101, 150, 198, 601, 698} <= set(cut)
    assert len(cut) == pytest.approx(200, abs=2)
    _, fates = passed_on(DirectionConfig(), 10, cut=lambda number: number in (3, 4))
    assert [number for number, fate in enumerate(fates) if fate == DeliveryFlags.CUT] == [3, 4]


def test_a_corrupted_message_is_never_let_in():
    data = Command(position=(0.01,) * 8).pack(7, 1, now_ns())
    memory = StreamState()
    for _ in range(500):
        ((_, changed),), _, memory = model.step(
            DirectionConfig(corrupt=1.0), KEY, memory, 0.0, data
        )
        with pytest.raises(MessageError):
            Command.unpack(changed)


def test_reliable_topics_are_late_but_whole_unless_asked_otherwise():
    worst = DirectionConfig(
        delay=0.1, jitter=0.05, loss=1.0, burst_loss=0.5, reorder=1.0, duplicate=1.0, corrupt=1.0,
        cuts=((0.0, 1.0),),
    )  # fmt: skip
    assert worst.select_impairments(live=True) == worst
    _, fates = passed_on(worst.select_impairments(live=False), 1500)
    assert set(fates[1000:]) == {DeliveryFlags.PASSED}
    assert set(fates[:1000]) == {DeliveryFlags.CUT}
    clean = DirectionConfig(delay=0.1, loss=1.0, reliable="clean").select_impairments(live=False)
    assert clean == DirectionConfig()


# --- config ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("jitter", 0.1),  # of a delay of 0
        ("jitter_time", 1e-300),
        ("burst_loss", 0.99),
        ("cuts", ((2.0, 1.0),)),
    ],
)
def test_what_no_network_does_is_refused(field, value):
    with pytest.raises(ValueError, match=f"^{field}: "):
        DirectionConfig(**{field: value})


def test_an_option_of_the_command_counts_both_ways():
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    overrides = command.build_overrides(parser.parse_args(["--loss", "0.1"]))
    impair = ConfigDocument(overrides=tuple(overrides)).load(ImpairConfig, "impair")
    assert impair.to_slave.loss == impair.to_master.loss == 0.1


def test_the_proxy_leaves_the_machine_no_easier_than_a_side():
    with pytest.raises(UsageError, match=r"^impair\.endpoint: .*off loopback, link\.keys must"):
        ImpairConfig(endpoint="10.0.0.1:7449").build_link_config(LinkConfig())


# --- the delay queue ------------------------------------------------------------------------------


def test_the_delay_queue_hands_over_in_order_of_time_then_of_sending():
    queue, out = DelayQueue(), []
    now = time.monotonic_ns()
    for name, due in ((b"c", 3), (b"a", 1), (b"b", 2), (b"d", 3)):
        queue.send(now + due * 1_000_000, out.append, name)
    while len(queue):
        queue.send_due()
    assert out == [b"a", b"b", b"c", b"d"]
    assert time.monotonic_ns() >= now + 3_000_000
    assert queue.lateness.compute_percentiles(1.0).n == 4


@given(
    st.integers(1, 20),
    st.lists(st.tuples(st.integers(0, 5), st.integers(0, 30)), max_size=60),
    st.booleans(),
)
def test_a_full_delay_queue_refuses_the_newest_and_keeps_the_order_of_the_others(
    room, messages, late
):
    """Whatever is accepted comes out once, by due time and then by order of sending."""
    capacity, out, accepted, held = 100 + room * ENTRY_BYTES, [], [], 0
    queue = DelayQueue(capacity)
    now = time.monotonic_ns() - 10**9
    for number, (due, length) in enumerate(messages):
        data = bytes([number]) + bytes(length)
        fits = held + len(data) + ENTRY_BYTES <= capacity
        assert queue.send(now + due, out.append, data) == fits
        if fits:
            held += len(data) + ENTRY_BYTES
            accepted.append((due, number))
    assert held <= capacity
    assert len(queue) == len(accepted)
    if len(queue):
        queue.send_due()
    assert [data[0] for data in out] == [number for _, number in sorted(accepted)]
    if late:  # what was handed over has made room
        assert all(queue.send(now, out.append, b"") for _ in range(room))


def test_what_a_full_queue_refuses_is_counted_by_topic():
    near, far = unittest.mock.Mock(), unittest.mock.Mock()
    queue = DelayQueue(10 * (ENTRY_BYTES + 50))
    direction = Direction("to_slave", DirectionConfig(duplicate=1.0), 0, near, far, queue)
    for _ in range(20):
        direction.take(COMMAND, bytes(50))
    counts = direction.count_messages()["command"]
    assert (counts["came"], counts["sent"], counts["overflowed"]) == (20, 10, 30)
    queue.send_due()
    assert far.put(COMMAND).call_count == 10


# --- the process ----------------------------------------------------------------------------------


class Bridged:
    """A proxy process, and how to reach each side of it."""

    def __init__(self, folder, *arguments):
        ends = [f"127.0.0.1:{port}" for port in find_free_ports(3)]
        self.session = f"test-{uuid.uuid4().hex[:8]}"
        self.shared = LinkConfig(master=ends[0], slave=ends[1])
        self.to_proxy = LinkConfig(master=ends[0], slave=ends[2])
        self.summary = folder / "impair.json"
        words = [f"session={self.session}", f"link.master={ends[0]}", f"link.slave={ends[1]}"]
        words += [f"impair.endpoint={ends[2]}"]
        self.process = subprocess.Popen(
            [
                *(sys.executable, "-m", "teleop", "impair", "--json", str(self.summary)),
                *(f"--set={word}" for word in words),
                *arguments,
            ],
            env=os.environ | {SUPERVISED_VARIABLE: str(os.getpid())},
        )

    def send_request(self, *words):
        return send_request(self.to_proxy, self.session, self.to_proxy.slave, "\n".join(words))

    def count_commands(self):
        """Return what has become of commands so far."""
        self.counts = self.send_request("status")["to_slave"].get("command", {})
        return self.counts

    def answers(self):
        """Whether it is up."""
        try:
            return bool(self.send_request("status"))
        except TeleopError:
            return False

    def end(self):
        """End the proxy and return what it counted."""
        self.process.terminate()
        assert self.process.wait(10) == 0
        return json.loads(self.summary.read_text())


@pytest.fixture(scope="module")
def proxy(tmp_path_factory):
    proxy = Bridged(tmp_path_factory.mktemp("proxy"), "--set", "impair.presence=0.3")
    try:
        assert wait_for_condition(proxy.answers, 20.0)
        yield proxy
        assert proxy.end()["to_slave"]["command"] == proxy.counts
    finally:
        proxy.process.kill()
        proxy.process.wait()


def sides(proxy):
    """Return master and slave of a bridged session, not entered yet."""
    slave = Link(proxy.shared, proxy.session, Role.SLAVE)
    return Link(proxy.to_proxy, proxy.session, Role.MASTER), slave


def both_there(master, slave):
    return master.is_present(Role.SLAVE) and slave.is_present(Role.MASTER)


def await_way(master, slave, listener):
    """Wait until both are announced to each other, and commands get through."""
    assert wait_for_condition(lambda: both_there(master, slave), 5.0)

    def heard():
        master.publish(COMMAND, Command())
        return bool(listener.drain())

    assert wait_for_condition(heard, 5.0)
    time.sleep(0.1)  # until the last of these has come
    listener.drain()


def publish(link, topic, message, count, period_s=PERIOD_S):
    """Publish `count` messages on a grid."""
    begin = time.monotonic()
    for number in range(count):
        time.sleep(max(0.0, begin + number * period_s - time.monotonic()))
        link.publish(topic, message)


@pytest.mark.real_time
def test_the_sides_meet_through_the_proxy_and_hear_what_it_lets_through(proxy):
    shares = {"loss": 0.1, "corrupt": 0.05, "duplicate": 0.05}
    proxy.send_request("set", *(f"to_slave.{name}={share}" for name, share in shares.items()))
    before = proxy.count_commands()
    master, slave = sides(proxy)
    with slave, master:
        listener = slave.listen((COMMAND, EVENT))
        master.subscribe_latest(STATE)
        await_way(master, slave, listener)
        publish(master, COMMAND, Command(), 1000)
        master.publish(EVENT, Event(role=Role.MASTER, text=encode_text("hello")))
        slave.publish(STATE, SlaveState())
        assert wait_for_condition(lambda: master.take_latest(STATE).message is not None, 2.0)
        time.sleep(0.2)
        heard = listener.drain()
        assert sum(item.topic is EVENT for item in heard) == 1
        counts = listener.count_messages(COMMAND)
        told = {name: n - before.get(name, 0) for name, n in proxy.count_commands().items()}
        assert told["came"] > 900  # a stalled machine drops some before they are here
        assert told["sent"] == told["came"] - told["lost"] + told["duplicated"]
        assert 50 < told["lost"] < 170
        assert told["corrupted"] > 0
        # every message that was sent is accounted for on the other side, by kind
        refused = listener.count_refused(COMMAND)  # their tags do not fit
        assert counts.received + counts.rejected + refused == told["sent"]
        both = told["duplicated"] - counts.repeated  # copies of messages that were corrupted too
        assert 0 <= both <= 10
        assert counts.corrupted + counts.layout + refused == told["corrupted"] + both
    proxy.send_request("set", *(f"to_slave.{name}=0" for name in shares))


@pytest.mark.real_time
def test_delay_and_cut_are_those_of_the_command_and_presence_ends_with_who_was_present(proxy):
    before = proxy.count_commands()
    master, slave = sides(proxy)
    late = {}
    with slave, master:
        listener = slave.listen((COMMAND,))
        await_way(master, slave, listener)
        for delay_s in (0.0, 0.05):
            proxy.send_request("set", f"to_slave.delay={delay_s}")
            publish(master, COMMAND, Command(), 300)
            time.sleep(0.2)
            ages_ns = [item.received_ns - item.stamp_ns for item in listener.drain()]
            late[delay_s] = np.array(ages_ns) * 1e-9
        # the earliest: a busy machine holds up some of either, never all
        assert 0.05 <= late[0.05].min() <= 0.051 + late[0.0].min()

        def heard():
            publish(master, COMMAND, Command(), 50, period_s=0.005)
            time.sleep(0.2)
            return len(listener.drain())

        assert heard() > 40
        proxy.send_request("cut", "to_slave")
        assert heard() == 0
        assert wait_for_condition(lambda: not slave.is_present(Role.MASTER), 2.0)
        assert master.is_present(Role.SLAVE)  # the other way is whole
        proxy.send_request("mend")
        assert wait_for_condition(lambda: slave.is_present(Role.MASTER), 2.0)
        assert heard() > 40
        with pytest.raises(TeleopError, match="allowed are to_slave, to_master"):
            proxy.send_request("cut", "sideways")
        with pytest.raises(TeleopError, match=r"loss: .*0 to 1"):
            proxy.send_request("set", "to_slave.loss=2")
        master.__exit__(None, None, None)
        assert wait_for_condition(lambda: not slave.is_present(Role.MASTER), 2.0)
    assert 40 < proxy.count_commands()["cut"] - before.get("cut", 0) <= 50
