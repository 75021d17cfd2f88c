"""The link: config rules, bookkeeping of arrivals, presence, and real sessions on loopback."""

import itertools
import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from teleop.clock import now_ns
from teleop.errors import PeerError, UsageError
from teleop.link import NEVER_NS, Counts, Latest, Link, LinkConfig, TlsConfig
from teleop.link import link as link_module
from teleop.link.config import Endpoint
from teleop.link.listener import Listener
from teleop.link.network import open_session
from teleop.link.ping_pong import ping_pong
from teleop.link.presence import EXCLUSIVE, Stage, Token, conflict, new_nonce
from teleop.link.reception import DRIFT, Reception
from teleop.messages import LAYOUT, Command, Event, LoopReport, SlaveState, text_bytes
from teleop.topics import COMMAND, EVENT, HAND, REPORT, STATE, TOPICS, Role

MS = 1_000_000
SETTLE_S = link_module.SETTLE_S


def free_config(**changes: Any) -> LinkConfig:
    """A link on two loopback ports that nobody has."""
    with socket.socket() as one, socket.socket() as two:
        for probe in (one, two):
            probe.bind(("127.0.0.1", 0))
        ports = [probe.getsockname()[1] for probe in (one, two)]
    endpoints = dict(zip(("master", "slave"), (f"tcp/127.0.0.1:{p}" for p in ports), strict=True))
    return LinkConfig(**(endpoints | changes))


def wait_until(condition: Callable[[], bool], seconds: float = 10.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.002)


# --- config ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "endpoint", "loopback"),
    [
        ("tcp/127.0.0.1:7447", ("tcp", "127.0.0.1", 7447), True),
        ("tcp/127.8.9.1:1", ("tcp", "127.8.9.1", 1), True),
        ("tcp/localhost:65535", ("tcp", "localhost", 65535), True),
        ("tls/[::1]:7447", ("tls", "::1", 7447), True),
        ("tls/console.lab.example:7447", ("tls", "console.lab.example", 7447), False),
        ("tcp/192.168.1.2:7447", ("tcp", "192.168.1.2", 7447), False),
        ("tcp/127.0.0.1.example.org:7447", ("tcp", "127.0.0.1.example.org", 7447), False),
    ],
)
def test_endpoints(text: str, endpoint: tuple[str, str, int], loopback: bool) -> None:
    assert Endpoint.parse(text) == endpoint
    assert Endpoint.parse(text).loopback == loopback


@pytest.mark.parametrize(
    "text",
    [
        "", "127.0.0.1:7447", "udp/127.0.0.1:7447", "tcp/127.0.0.1", "tcp/127.0.0.1:0",
        "tcp/127.0.0.1:65536", "tcp/:7447", "tcp/::1:7447", "tcp/[::1:7447", "tcp/[localhost]:7447",
        "tcp/0.0.0.0:7447", "tcp/[::]:7447", "tcp/224.0.0.1:7447", "tcp/a b:7447", "tcp/-a:7447",
        "tcp/127.0.0.1:7447;tcp/10.0.0.1:7447", "tcp/127.0.0.1:7447#iface=eth0", "tcp/*:7447",
    ],
)  # fmt: skip
def test_bad_endpoints_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"endpoint|port|host|connected"):
        Endpoint.parse(text)
    with pytest.raises(ValueError, match=r"^slave: "):
        LinkConfig(slave=text)


def test_plaintext_never_leaves_the_machine_unasked(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"^slave: plain tcp leaves this machine.*link\.tls"):
        LinkConfig(slave="tcp/192.168.1.2:7448")
    with pytest.raises(ValueError, match=r"^master: plain tcp leaves this machine"):
        LinkConfig(master="tcp/rig.lab:7447")
    asked = LinkConfig(slave="tcp/192.168.1.2:7448", insecure_plaintext_off_loopback=True)
    assert asked.slave.startswith("tcp/192")
    with pytest.raises(ValueError, match=r"^slave: needs link\.tls"):
        LinkConfig(slave="tls/192.168.1.2:7448")
    for name in ("ca", "certificate", "key"):
        (tmp_path / name).touch()
    tls = TlsConfig(ca=tmp_path / "ca", certificate=tmp_path / "certificate", key=tmp_path / "key")
    with pytest.raises(ValueError, match=r"^master: link\.tls is given"):
        LinkConfig(slave="tls/192.168.1.2:7448", tls=tls, insecure_plaintext_off_loopback=True)
    LinkConfig(master="tls/192.168.1.1:7447", slave="tls/192.168.1.2:7448", tls=tls)


def test_missing_certificates_and_twice_the_same_endpoint_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"^ca: no such file"):
        TlsConfig(ca=tmp_path / "no", certificate=tmp_path / "no", key=tmp_path / "no")
    with pytest.raises(ValueError, match=r"^slave: the same endpoint"):
        LinkConfig(master="tcp/127.0.0.1:7000", slave="tcp/127.0.0.1:7000")


# --- presence -------------------------------------------------------------------------------------

TOKENS = st.builds(
    Token,
    role=st.sampled_from(list(Role)),
    layout=st.sampled_from([1, 2]),
    nonce=st.integers(0, 2**64 - 1),
    stage=st.sampled_from(list(Stage)),
    relayed=st.booleans(),
)


@given(TOKENS)
def test_a_token_survives_its_key(token: Token) -> None:
    assert Token.from_key(token.key("demo")) == token


@given(st.text())
def test_a_foreign_key_is_no_token(text: str) -> None:
    assert Token.from_key(f"teleop/x/@/{text}") is None or text.count("/") >= 3


@given(TOKENS, TOKENS)
def test_of_two_that_cannot_both_be_there_exactly_one_leaves(one: Token, two: Token) -> None:
    both = one.role in EXCLUSIVE and two.role in EXCLUSIVE and one.nonce != two.nonce
    clash = both and (one.role == two.role or one.layout != two.layout)
    leaves = [conflict(one, [two]) is not None, conflict(two, [one]) is not None]
    if both:
        assert sum(leaves) == clash
    if clash and one.stage != two.stage:
        assert leaves[one.stage < two.stage] == 0 or leaves[0] == (one.stage < two.stage)
        assert leaves[0] == (one.stage < two.stage)


@given(TOKENS, TOKENS)
def test_listeners_make_nobody_leave_and_leave_only_for_another_layout(
    one: Token, two: Token
) -> None:
    if two.role not in EXCLUSIVE:
        assert conflict(one, [two]) is None
    if one.role not in EXCLUSIVE and two.role in EXCLUSIVE and one.nonce != two.nonce:
        assert (conflict(one, [two]) is not None) == (one.layout != two.layout)


def test_nonces_differ_and_grow() -> None:
    drawn = []
    for _ in range(200):
        drawn.append(new_nonce())
        time.sleep(1e-5)
    assert drawn == sorted(set(drawn))


# --- what arrives ---------------------------------------------------------------------------------


def packed(sequence: int, sender: int = 7, stamp_ns: int = 0) -> bytes:
    return Command().pack(sender, sequence, stamp_ns)


def total(counts: Counts) -> int:
    return counts.received + counts.rejected


@given(st.lists(st.integers(1, 40), max_size=60), st.randoms(use_true_random=False))
def test_every_arrival_is_counted_once_and_what_is_let_in_only_ever_gets_newer(
    sequences: list[int], chance: random.Random
) -> None:
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


def test_a_gap_behind_a_full_channel_is_overwritten_not_lost() -> None:
    reception = Reception(COMMAND, visit=lambda _: True)
    reception.admit(packed(1))
    reception.admit(packed(5), overflowed=True)
    reception.admit(packed(8))
    assert (reception.counts.overwritten, reception.counts.lost) == (3, 2)


def test_another_sender_is_let_in_only_when_ours_is_gone_and_it_is_announced() -> None:
    there = {7}
    reception = Reception(COMMAND, visit=lambda nonce: nonce in there)
    assert reception.admit(packed(1, sender=9)) is None  # unknown so far: passed over
    assert reception.counts == Counts(unknown=1)
    assert reception.counts.rejected == 0
    assert reception.admit(packed(5, sender=7))
    there.add(9)
    assert reception.admit(packed(100, sender=9)) is None
    assert reception.counts.foreign == 1
    there.discard(7)
    assert reception.admit(packed(1, sender=9))
    assert reception.admit(packed(6, sender=7)) is None
    assert reception.counts == Counts(received=2, restarts=1, foreign=2, unknown=1)


def test_a_message_of_another_topic_or_layout_is_counted_as_layout() -> None:
    reception = Reception(COMMAND, visit=lambda _: True)
    assert reception.admit(SlaveState().pack(7, 1, 0)) is None
    assert reception.admit(b"") is None
    assert reception.counts.layout == 2


def test_no_message_is_older_than_any_limit() -> None:
    latest = Latest(COMMAND, visit=lambda _: True)
    assert latest.age_ns(0) == NEVER_NS
    assert not latest.is_fresh(0, 10**18)
    latest.take([], 5, overflowed=False)
    assert not latest.new


@pytest.mark.parametrize("offset_ns", [0, -5_000_000_000_000, 123_456_789])
def test_age_is_time_since_sent_less_the_quickest_way_whatever_the_clocks_say(
    offset_ns: int,
) -> None:
    """Against a simulated wire on which the true age of every message is known."""
    chance = random.Random(1)  # noqa: S311 - a wire, not a secret
    latest = Latest(COMMAND, visit=lambda _: True)
    quickest = 200_000
    in_flight: list[tuple[int, int]] = []  # (arrives, sent), on our clock
    newest_sent = None
    for tick in range(3000):
        now = tick * MS
        stalled = 1000 <= tick < 1300
        delay = quickest + int(chance.expovariate(1e-5)) + (1300 - tick) * MS * stalled
        in_flight.append((now + delay, now))
        arrived = sorted(m for m in in_flight if m[0] <= now)
        in_flight = [m for m in in_flight if m[0] > now]
        data = [packed(sent // MS + 1, stamp_ns=sent + offset_ns) for _, sent in arrived]
        latest.take(sorted(data, key=lambda d: Command.unpack(d).sequence), now, overflowed=False)
        if arrived:
            newest_sent = max([newest_sent or 0, *(sent for _, sent in arrived)])
        if tick > 100 and newest_sent is not None:
            truth = now - newest_sent
            age = latest.age_ns(now)
            slack = 3 * MS + 300 * MS // DRIFT  # one poll, the quickest way, the drift of a stall
            assert truth - slack <= age <= truth + slack


def test_a_message_that_was_held_up_is_old_when_it_arrives() -> None:
    latest = Latest(COMMAND, visit=lambda _: True)
    for k in range(100):
        latest.take([packed(k + 1, stamp_ns=k * MS)], k * MS, overflowed=False)
    assert latest.is_fresh(99 * MS, 2 * MS)
    latest.take([packed(101, stamp_ns=100 * MS)], 600 * MS, overflowed=False)
    assert latest.new
    assert not latest.is_fresh(600 * MS, 400 * MS)
    latest.take([packed(700, stamp_ns=601 * MS)], 601 * MS, overflowed=False)
    assert latest.is_fresh(601 * MS, 2 * MS)


def test_the_clocks_of_a_restarted_sender_are_learnt_anew() -> None:
    there = {7}
    latest = Latest(COMMAND, visit=lambda nonce: nonce in there)
    latest.take([packed(1, sender=7, stamp_ns=10**15)], 0, overflowed=False)
    there.symmetric_difference_update({7, 9})
    latest.take([packed(1, sender=9, stamp_ns=0)], 10 * MS, overflowed=False)
    assert latest.age_ns(10 * MS) == 0


@pytest.mark.parametrize("gain", [0.0005, -0.0005])
def test_clocks_that_run_at_different_speeds_do_not_make_messages_old(gain: float) -> None:
    """The most that NTP slews, for ten minutes: 0.3 s between the clocks in the end."""
    latest = Latest(COMMAND, visit=lambda _: 1)
    for k in range(60_000):
        now = k * 10 * MS
        data = packed(k + 1, stamp_ns=round(now * (1.0 - gain)))
        latest.take([data], now, overflowed=False)
        assert latest.is_fresh(now, 1 * MS)


def test_a_peer_that_slept_is_fresh_again_once_its_token_has_come_back() -> None:
    visit = {7: 1}
    latest = Latest(COMMAND, visit=lambda nonce: visit[nonce])
    slept = 10_000 * MS
    latest.take([packed(1, stamp_ns=0)], 0, overflowed=False)
    visit[7] = 0
    latest.take([packed(2, stamp_ns=MS)], slept, overflowed=False)
    assert not latest.is_fresh(slept, 9_000 * MS)  # until then it is taken for held up
    visit[7] = 2
    for k in range(3, 10):
        now = slept + k * MS
        latest.take([packed(k, stamp_ns=k * MS)], now, overflowed=False)
        assert latest.is_fresh(now, MS)
    latest.take([packed(10, stamp_ns=10 * MS)], slept + 510 * MS, overflowed=False)
    assert not latest.is_fresh(slept + 510 * MS, 400 * MS)  # what is held up is old as before


# --- sessions on loopback -------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def short_settling(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(link_module, "SETTLE_S", 0.05)


@pytest.fixture
def true_settling(monkeypatch: pytest.MonkeyPatch, short_settling: None) -> None:
    monkeypatch.setattr(link_module, "SETTLE_S", SETTLE_S)


@pytest.fixture
def config() -> LinkConfig:
    return free_config()


@contextmanager
def session(config: LinkConfig, *roles: Role) -> Iterator[list[Link]]:
    """Links of these roles, opened in this order, all of them knowing each other."""
    with ExitStack() as stack:
        links = [stack.enter_context(Link(config, "test", role)) for role in roles]
        for one, two in itertools.permutations(links, 2):
            if one.role in EXCLUSIVE or two.role in EXCLUSIVE:
                wait_until(lambda one=one, two=two: one.present(two.role))
        time.sleep(0.05)
        yield links


def pump(sender: Link, receiver: Link, count: int = 1) -> Latest[Command]:
    """Publish commands until the receiver has let in `count` more."""
    latest = receiver.latest(COMMAND)
    goal = latest.counts.received + count

    def heard() -> bool:
        sender.publish(COMMAND, Command(state=1))
        return receiver.latest(COMMAND).counts.received >= goal

    wait_until(heard)
    return latest


def test_messages_cross_whole_and_in_order(config: LinkConfig) -> None:
    with session(config, Role.SLAVE, Role.MASTER, Role.RECORDER) as (slave, master, recorder):
        for link, topic in ((slave, COMMAND), (master, STATE)):
            link.subscribe_latest(topic)
        listener = recorder.listen(TOPICS)
        time.sleep(0.1)
        sent = []
        for k in range(50):
            stamp = master.publish(COMMAND, Command(state=k, position=(k * 0.5,) * 8))
            slave.publish(STATE, SlaveState(joints=k, echo_stamp_ns=stamp))
            sent.append(stamp)
            time.sleep(0.002)
        slave.publish(EVENT, Event(role=Role.SLAVE, text=text_bytes("ready")))
        master.publish(REPORT, LoopReport(role=Role.MASTER))
        slave.publish(REPORT, LoopReport(role=Role.SLAVE))

        wait_until(lambda: slave.latest(COMMAND).counts.received > 0)
        wait_until(lambda: master.latest(STATE).counts.received > 0)
        command, state = slave.latest(COMMAND).message, master.latest(STATE).message
        assert command is not None
        assert state is not None
        assert command.sender == master.nonce
        assert command.stamp_ns == sent[command.sequence - 1]
        assert command.state == command.sequence - 1
        assert command.position == (command.state * 0.5,) * 8
        assert state.echo_stamp_ns == sent[state.joints]

        heard: list[Any] = []
        wait_until(lambda: heard.extend(listener.drain()) or listener.counts(REPORT).received == 2)
        assert {h.sender for h in heard if h.topic == REPORT} == {master.nonce, slave.nonce}
        commands = [h for h in heard if h.topic == COMMAND]
        assert len(commands) > 25
        assert [h.sequence for h in commands] == sorted({h.sequence for h in commands})
        for h in commands:
            assert Command.unpack(h.data).state == h.sequence - 1
            assert h.stamp_ns == sent[h.sequence - 1]
            assert h.sender == master.nonce
            assert h.received_ns >= h.stamp_ns - MS
        counts = listener.counts(COMMAND)
        first, last = commands[0].sequence, commands[-1].sequence
        assert counts == Counts(received=len(commands), lost=last - first + 1 - len(commands))


def test_new_is_true_for_one_look_and_age_grows_until_the_next_message(config: LinkConfig) -> None:
    with session(config, Role.SLAVE, Role.MASTER) as (slave, master):
        latest = pump(master, slave)
        assert latest.new
        time.sleep(0.2)  # what is still on its way
        slave.latest(COMMAND)
        assert not slave.latest(COMMAND).new
        first = latest.age_ns(now_ns())
        time.sleep(0.05)
        assert slave.latest(COMMAND).age_ns(now_ns()) >= first + 50 * MS


def test_a_late_look_finds_the_newest_and_calls_the_rest_overwritten(config: LinkConfig) -> None:
    with session(config, Role.SLAVE, Role.MASTER) as (slave, master):
        pump(master, slave)
        time.sleep(0.05)
        slave.latest(COMMAND)
        before = slave.latest(COMMAND).counts.received
        for k in range(100):
            master.publish(COMMAND, Command(state=k))
            time.sleep(0.0005)
        time.sleep(0.1)
        latest = slave.latest(COMMAND)
        assert latest.message is not None
        assert latest.message.state > 90
        assert latest.counts.overwritten >= 75
        assert latest.counts.lost <= 10
        assert latest.counts.received - before <= 16
        assert slave.counts() == latest.counts


def test_sessions_on_the_same_endpoints_do_not_hear_each_other(config: LinkConfig) -> None:
    with Link(config, "one", Role.SLAVE) as slave, Link(config, "two", Role.MASTER) as master:
        slave.subscribe_latest(COMMAND)
        for _ in range(50):
            master.publish(COMMAND, Command())
            time.sleep(0.002)
        assert slave.latest(COMMAND).message is None
        assert not slave.present(Role.MASTER)
        assert not master.present(Role.SLAVE)


def test_without_a_peer_publishing_is_quiet_and_the_peer_is_found_when_it_comes(
    config: LinkConfig,
) -> None:
    with Link(config, "test", Role.MASTER) as master:
        for _ in range(100):
            master.publish(COMMAND, Command())
        assert not master.present(Role.SLAVE)
        master.check_peers()
        with Link(config, "test", Role.SLAVE) as slave:
            wait_until(lambda: master.present(Role.SLAVE))
            pump(master, slave)
        wait_until(lambda: not master.present(Role.SLAVE))
        for _ in range(100):
            master.publish(COMMAND, Command())
        with Link(config, "test", Role.SLAVE) as slave:
            pump(master, slave)


def test_a_restarted_master_is_taken_up_again_and_counted(config: LinkConfig) -> None:
    with Link(config, "test", Role.SLAVE) as slave:
        with Link(config, "test", Role.MASTER) as master:
            pump(master, slave, 20)
        with Link(config, "test", Role.MASTER) as master:
            latest = pump(master, slave, 3)
            assert latest.message is not None
            assert latest.message.sender == master.nonce
        assert latest.counts.restarts == 1
        assert latest.counts.foreign == 0
        assert latest.counts.lost == 0


def test_a_machine_that_slept_is_not_silent_after_it_has_come_back(config: LinkConfig) -> None:
    """The same process as far as anyone can tell, its clock ten seconds behind."""
    nonce, sequence = new_nonce(), itertools.count(1)
    with Link(config, "test", Role.SLAVE) as slave:
        latest = slave.subscribe_latest(COMMAND)
        for behind_ns in (0, 10_000 * MS):
            master = Link(config, "test", Role.MASTER)
            master.nonce = nonce
            master._token = Token(Role.MASTER, LAYOUT, nonce, Stage.CLAIM)
            with master:

                def fresh(master: Link = master, behind_ns: int = behind_ns) -> bool:
                    stamp = now_ns() - behind_ns
                    master.publish_raw(COMMAND, Command().pack(nonce, next(sequence), stamp))
                    time.sleep(0.002)
                    slave.latest(COMMAND)
                    return latest.new and latest.is_fresh(now_ns(), 20 * MS)

                wait_until(fresh, seconds=5.0)
            wait_until(lambda: not slave.present(Role.MASTER))
        assert latest.counts.restarts == 0


def test_what_an_intruder_puts_on_the_key_is_counted_and_kept_out(config: LinkConfig) -> None:
    with session(config, Role.SLAVE, Role.MASTER) as (slave, master):
        latest = pump(master, slave)
        with open_session(config, [], [config.slave]) as intruder:
            put = intruder.declare_publisher("teleop/test/command").put
            genuine = Command(state=2).pack(master.nonce, 10**6, now_ns())

            def counted() -> tuple[int, ...]:
                counts = slave.latest(COMMAND).counts
                return counts.layout, counts.corrupted, counts.foreign

            for data, expected in (
                (b"", (1, 0, 0)),
                (b"\0" * 5000, (2, 0, 0)),
                (genuine[:-1] + b"\x01", (2, 1, 0)),
                (Command(state=2).pack(12345, 10**6, now_ns()), (2, 1, 1)),
            ):

                def inject(data: bytes = data, expected: tuple[int, ...] = expected) -> bool:
                    if counted() != expected:
                        put(data)
                        time.sleep(0.02)
                    return counted() == expected

                wait_until(inject)
        assert latest.message is not None
        assert latest.message.sender == master.nonce
        assert latest.message.state == 1


@pytest.mark.usefixtures("true_settling")
def test_a_second_master_on_the_same_endpoint_is_refused(config: LinkConfig) -> None:
    with (
        session(config, Role.SLAVE, Role.MASTER) as (_, master),
        pytest.raises(PeerError, match=r"session 'test' has a master already"),
        Link(config, "test", Role.MASTER),
    ):
        pass
    assert master.role == Role.MASTER


@pytest.mark.usefixtures("true_settling")
def test_a_second_slave_is_refused(config: LinkConfig) -> None:
    with (
        Link(config, "test", Role.SLAVE),
        pytest.raises(PeerError, match=r"session 'test' has a slave already"),
        Link(config, "test", Role.SLAVE),
    ):
        pass


@pytest.mark.usefixtures("true_settling")
def test_a_second_master_from_another_machine_is_refused_and_the_first_stays(
    config: LinkConfig,
) -> None:
    elsewhere = free_config(slave=config.slave)
    with session(config, Role.SLAVE, Role.MASTER) as (slave, master):
        late = Link(elsewhere, "test", Role.MASTER)
        late.nonce = 1  # its clock is far behind, so it looks the oldest
        late._token = Token(Role.MASTER, LAYOUT, 1, Stage.CLAIM)
        with pytest.raises(PeerError, match=r"has a master already"), late:
            pass
        for link in (slave, master):
            link.check_peers()
        pump(master, slave)


@pytest.mark.usefixtures("true_settling")
def test_of_two_masters_started_at_once_one_runs(config: LinkConfig) -> None:
    with Link(config, "test", Role.SLAVE):
        for _ in range(3):
            opened, refused = [], []
            barrier = threading.Barrier(2)

            def start(
                mine: LinkConfig,
                opened: list[Link] = opened,
                refused: list[PeerError] = refused,
                barrier: threading.Barrier = barrier,
            ) -> None:
                link = Link(mine, "test", Role.MASTER)
                barrier.wait()
                try:
                    opened.append(link.__enter__())
                except PeerError as error:
                    refused.append(error)

            threads = [
                threading.Thread(target=start, args=(c,))
                for c in (config, free_config(slave=config.slave))
            ]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            for link in opened:
                link.__exit__(None, None, None)
            assert (len(opened), len(refused)) == (1, 1)


def test_two_masters_that_met_only_later_are_told_apart_while_running(config: LinkConfig) -> None:
    other = free_config(slave=config.slave)
    with Link(config, "test", Role.MASTER) as older, Link(other, "test", Role.MASTER) as younger:
        for link in (older, younger):
            link.check_peers()
        with Link(config, "test", Role.SLAVE):

            def younger_is_refused() -> bool:
                try:
                    younger.check_peers()
                except PeerError:
                    return True
                return False

            wait_until(younger_is_refused)
            older.check_peers()


@pytest.mark.parametrize("role", [Role.MASTER, Role.RECORDER])
@pytest.mark.usefixtures("true_settling")
def test_another_message_layout_is_refused_with_both_numbers(
    config: LinkConfig, monkeypatch: pytest.MonkeyPatch, role: Role
) -> None:
    with Link(config, "test", Role.SLAVE) as slave:
        monkeypatch.setattr(link_module, "LAYOUT", 0xABCDEF01)
        with (
            pytest.raises(PeerError, match=rf"{LAYOUT:08x}.*abcdef01.*same version"),
            Link(config, "test", role),
        ):
            pass
        slave.check_peers()


def test_a_port_of_someone_else_is_named_with_a_remedy(config: LinkConfig) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", Endpoint.parse(config.slave).port))
        other.listen()
        with pytest.raises(UsageError) as caught, Link(config, "test", Role.SLAVE):
            pass
    assert not isinstance(caught.value, PeerError)
    assert config.slave in str(caught.value)
    assert "another process has this port" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_address_of_another_machine_is_named_with_a_remedy() -> None:
    config = free_config(slave="tcp/192.0.2.1:7448", insecure_plaintext_off_loopback=True)
    with (
        pytest.raises(UsageError, match=r"192\.0\.2\.1:7448.*does not have that address"),
        Link(config, "test", Role.SLAVE),
    ):
        pass


def test_a_closed_link_leaves_its_port_free(config: LinkConfig) -> None:
    for _ in range(3):
        with Link(config, "test", Role.SLAVE):
            pass


def test_a_role_publishes_only_its_own_topics(config: LinkConfig) -> None:
    with Link(config, "test", Role.SLAVE) as slave:
        with pytest.raises(ValueError, match="hand is published by"):
            slave.publish(HAND, HAND.message())
        with pytest.raises(ValueError, match="several publishers"):
            slave.subscribe_latest(EVENT)


def test_a_listener_that_never_drains_keeps_a_bounded_backlog(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("teleop.link.listener.BACKLOG", 10)
    listener = Listener(lambda *_: True)

    class Sample:
        def __init__(self, data: bytes) -> None:
            self.payload = self
            self.to_bytes = lambda: data

    store: Any = listener.store(COMMAND)
    store(Sample(packed(1)))
    assert len(listener.drain()) == 1
    for k in range(2, 102):
        store(Sample(packed(k)))
    assert [h.sequence for h in listener.drain()] == list(range(92, 102))
    assert listener.counts(COMMAND) == Counts(received=11, lost=90)


PEER = """
import sys, time
from teleop.process import die_with_parent
die_with_parent(int(sys.argv[3]))
from teleop.link import Link, LinkConfig
from teleop.messages import Command
from teleop.topics import COMMAND, EVENT, STATE, Role
with Link(LinkConfig(master=sys.argv[1], slave=sys.argv[2]), "test", Role.MASTER) as link:
    link.subscribe_latest(STATE)
    listener = link.listen((EVENT,))
    while True:
        link.publish(COMMAND, Command())
        time.sleep(0.001)
"""


@contextmanager
def other_process(config: LinkConfig) -> Iterator[subprocess.Popen[bytes]]:
    """A master in a process of its own."""
    process = subprocess.Popen(
        [sys.executable, "-c", PEER, config.master, config.slave, str(os.getpid())],
        cwd=Path(__file__).parents[2],
    )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGCONT)
        process.kill()
        process.wait()


def test_a_killed_peer_is_gone_and_its_successor_welcome(config: LinkConfig) -> None:
    with Link(config, "test", Role.SLAVE) as slave:
        slave.subscribe_latest(COMMAND)
        with other_process(config) as first:
            wait_until(lambda: slave.latest(COMMAND).counts.received > 20)
            first.send_signal(signal.SIGKILL)
            wait_until(lambda: not slave.present(Role.MASTER), seconds=1.0)
        with other_process(config):
            wait_until(lambda: slave.latest(COMMAND).counts.restarts == 1)
            wait_until(lambda: slave.present(Role.MASTER))


def test_a_frozen_peer_grows_old_and_is_fresh_again_when_it_thaws(config: LinkConfig) -> None:
    with Link(config, "test", Role.SLAVE) as slave:
        slave.subscribe_latest(COMMAND)
        with other_process(config) as master:
            wait_until(lambda: slave.latest(COMMAND).counts.received > 100)
            master.send_signal(signal.SIGSTOP)
            wait_until(lambda: slave.latest(COMMAND).age_ns(now_ns()) > 300 * MS)
            assert slave.present(Role.MASTER)
            master.send_signal(signal.SIGCONT)
            wait_until(lambda: slave.latest(COMMAND).is_fresh(now_ns(), 20 * MS))


def test_publishing_to_a_frozen_peer_goes_on(config: LinkConfig) -> None:
    with Link(config, "test", Role.SLAVE) as slave, other_process(config) as master:
        wait_until(lambda: slave.latest(COMMAND).counts.received > 0)
        time.sleep(0.1)  # for its subscriptions to be known here
        master.send_signal(signal.SIGSTOP)
        longest = 0.0
        for _ in range(20_000):  # far more than all buffers on the way hold
            for topic, message in ((STATE, SlaveState()), (EVENT, Event())):
                began = time.monotonic()
                slave.publish(topic, message)
                longest = max(longest, time.monotonic() - began)
        assert longest < 1.0  # one that waits for room does so for 5 s


def openssl(folder: Path, *arguments: str) -> None:
    subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True)


def make_certificates(folder: Path) -> TlsConfig:
    """An authority, and a certificate of it for 127.0.0.1."""
    folder.mkdir()
    key = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")
    openssl(
        folder, "req", "-x509", *key, "-keyout", "ca.key", "-out", "ca.pem", "-days", "2",
        "-subj", "/CN=test authority",
    )  # fmt: skip
    openssl(folder, "req", *key, "-keyout", "key.pem", "-out", "request.pem", "-subj", "/CN=peer")
    (folder / "names").write_text(
        "subjectAltName=IP:127.0.0.1,DNS:localhost\nextendedKeyUsage=serverAuth,clientAuth\n"
        "basicConstraints=CA:FALSE\n"
    )
    openssl(
        folder, "x509", "-req", "-in", "request.pem", "-CA", "ca.pem", "-CAkey", "ca.key",
        "-CAcreateserial", "-out", "cert.pem", "-days", "2", "-extfile", "names",
    )  # fmt: skip
    return TlsConfig(ca=folder / "ca.pem", certificate=folder / "cert.pem", key=folder / "key.pem")


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> tuple[TlsConfig, TlsConfig]:
    """Ours, and those of someone with an authority of his own."""
    folder = tmp_path_factory.mktemp("certificates")
    try:
        return make_certificates(folder / "ours"), make_certificates(folder / "theirs")
    except FileNotFoundError:
        pytest.skip("needs the openssl command")


def over_tls(tls: TlsConfig, like: LinkConfig) -> LinkConfig:
    return LinkConfig(
        master=like.master.replace("tcp", "tls"), slave=like.slave.replace("tcp", "tls"), tls=tls
    )


def test_mutual_tls_lets_our_own_in(
    certificates: tuple[TlsConfig, TlsConfig], config: LinkConfig
) -> None:
    with session(over_tls(certificates[0], config), Role.SLAVE, Role.MASTER) as (slave, master):
        pump(master, slave, 20)


def test_mutual_tls_keeps_out_another_authority_and_plain_tcp(
    certificates: tuple[TlsConfig, TlsConfig], config: LinkConfig
) -> None:
    ours, theirs = certificates
    believes_us = TlsConfig(ca=ours.ca, certificate=theirs.certificate, key=theirs.key)
    with Link(over_tls(ours, config), "test", Role.SLAVE) as slave:
        slave.subscribe_latest(COMMAND)
        for intruder in (over_tls(theirs, config), over_tls(believes_us, config), config):
            with Link(intruder, "test", Role.MASTER) as master:
                for _ in range(100):
                    master.publish(COMMAND, Command())
                    time.sleep(0.003)
                    assert not slave.present(Role.MASTER)
                    assert not master.present(Role.SLAVE)
        assert slave.latest(COMMAND).counts == Counts()


def test_the_yardstick_measures_and_cleans_up() -> None:
    result = ping_pong(Command.schema.size, SlaveState.schema.size, 50)
    assert result["n"] > 0
    assert 0.0 < result["one_way_p50_ms"] < result["p50_ms"]
    assert result["p50_ms"] <= result["p99_ms"] <= result["p99_9_ms"]
