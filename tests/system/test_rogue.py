"""A rogue peer beside a real session: nothing moves, and the session recovers."""

import struct
import subprocess
import sys
import time

import pytest

from studies.testbed.processes import OURS, START_S, Processes, wait_for_condition
from teleop.messages.messages import LAYOUT, Event, decode_text
from teleop.messages.topics import EVENT, HAND, STATE, Role
from teleop.security import CertificateRole
from teleop.security.credentials import create_local_credentials
from teleop.session.state_machine import State
from tests.rogue import ENGAGED, POSITION_AT, RESET, STATE_AT, Rogue, forged, head

STILL = 1e-4  # [m] a tip at rest stays within
STANDING = 8000  # tokens that a rogue declares and keeps
ENGAGEMENTS = 10
FAR = struct.pack("<8d", *(0.014,) * 8)  # [m]
TAKE_OVER = ((STATE_AT, struct.pack("<I", ENGAGED)), (POSITION_AT, FAR))


def state_of(link):
    message = link.take_latest(STATE).message
    assert message is not None
    return message


def rogue_of(session, role):
    ends = [session.link_config.slave, session.link_config.master]
    tls = create_local_credentials(session.session, role).build_tls_settings()
    rogue = Rogue(ends, session.session, tls)
    for topic in ("command", "state"):
        rogue.listen(topic)
    return rogue


def attack(rogue, sides, seconds):
    """Everything at once: forged and played-back messages, tokens, resets, settings."""
    command, tags = next(item for item in reversed(rogue.heard["command"]))
    state, _ = rogue.heard["state"][-1]
    master, slave = sides
    for role in ("master", "slave", "remote"):
        rogue.announce(role, LAYOUT, 1)
    end, n = time.monotonic() + seconds, 0
    while time.monotonic() < end:
        n += 1
        rogue.put("command", forged("Command", command, 10**9 + n, *TAKE_OVER), tags)
        rogue.put("command", command, tags)
        rogue.put("state", forged("SlaveState", state, 10**9 + n, TAKE_OVER[0]), tags)
        for sender in (master, slave, n):
            rogue.stop(LAYOUT, sender, 0)
            rogue.stop(LAYOUT, sender, RESET, side=2, number=n % 4)
            rogue.set(LAYOUT, sender, b"force.scale", b"1")
        time.sleep(0.002)


def teleop(session, *words):
    command = [sys.executable, "-m", "teleop", *words, *session.shared]
    return subprocess.run(command, env=OURS, timeout=60, check=False).returncode


@pytest.mark.slow
def test_a_rogue_beside_a_session_moves_nothing(demo_config, tmp_path):
    late = "master.device.engage=[[25, 55]]", "master.device.engage_period=60"
    with Processes(tmp_path, demo_config, *late) as session:
        session.start("slave")
        session.start("master")
        with session.look() as link, rogue_of(session, CertificateRole.ROUTER) as rogue:
            link.subscribe_latest(STATE)
            listener = link.listen((EVENT,))
            assert wait_for_condition(lambda: link.take_latest(HAND).message is not None, START_S)
            assert wait_for_condition(lambda: all(rogue.heard.values()), 10.0), (
                "the rogue hears nothing"
            )
            sides = tuple(head(rogue.heard[topic][-1][0])[2] for topic in ("command", "state"))
            before = state_of(link)
            attack(rogue, sides, 3.0)
            after = state_of(link)
            assert after.state == State.READY, session.outputs()
            assert abs(after.position[0] - before.position[0]) < STILL
            # a stop is reset by nobody else
            assert teleop(session, "stop") == 0
            attack(rogue, sides, 1.0)
            assert state_of(link).state == State.STOPPED
            assert teleop(session, "stop", "--reset") == 0
            # it engages as if nothing had been, and stays so under attack
            assert wait_for_condition(lambda: session.engaged(link), 90.0), session.outputs()
            attack(rogue, sides, 2.0)
            assert state_of(link).state == State.ENGAGED, session.outputs()
            assert session.engaged(link), session.outputs()
            lines = {
                (event.role, decode_text(event.text).split(" (")[0])
                for event in (Event.unpack(item.data) for item in listener.drain())
            }
        for side in (Role.MASTER, Role.SLAVE):
            assert (side, "refused: stop of an unknown sender") in lines
        assert (Role.SLAVE, "refused: messages of the peer with a wrong tag") in lines


def watch(link, seconds):
    """Return the states that each side was seen in, in order."""
    seen = {"master": [], "slave": []}
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        for side, topic in (("master", HAND), ("slave", STATE)):
            message = link.take_latest(topic).message
            if message is not None and seen[side][-1:] != [message.state]:
                seen[side].append(State(message.state))
        time.sleep(0.002)
    return seen


@pytest.mark.slow
@pytest.mark.parametrize("role", [CertificateRole.ROUTER, CertificateRole.VIEWER])
def test_standing_tokens_interrupt_no_engagement(demo_config, tmp_path, role):
    period = 4.0  # [s]
    hand = "master.device.engage=[[1, 3.5]]", f"master.device.engage_period={period}"
    with Processes(tmp_path, demo_config, "rate_hz=250", *hand) as session:
        session.start("slave")
        session.start("master")
        with session.look() as link, rogue_of(session, role) as rogue:
            link.subscribe_latest(STATE)
            assert wait_for_condition(lambda: session.engaged(link), START_S), session.outputs()
            for n in range(STANDING):
                rogue.announce(("viewer", "remote", "master", "slave")[n % 4], LAYOUT, n, proof="A")
            seen = watch(link, (ENGAGEMENTS + 1) * period)
            assert rogue.connected()
    for side, states in seen.items():
        assert states.count(State.ENGAGED) >= ENGAGEMENTS, (side, states)
        assert set(states) <= {State.READY, State.ENGAGED}, (side, states)
