"""One side is killed in the middle of a session; a recording tells what the other side did."""

import os

import numpy as np
import pytest

from studies.testbed.processes import START_S, Processes, pause
from teleop.launch.supervisor import wait_for_condition
from teleop.messages.topics import HAND, STATE
from teleop.recording.reader import read_columns
from teleop.session.state_machine import State

LIMIT_NS = 50_000_000  # what the other side has to be safe, counted from the last message sent
RATE = "rate_hz=250"
HELD = ("master.device.engage=[[0.5, 1000.0]]", "master.device.engage_period=.inf")
# the monotonic clock of another machine, started 11 days earlier; only root has time namespaces
AHEAD = ("unshare", "-T", "--monotonic", "1000000", "--boottime", "1000000", "--")


@pytest.mark.slow  # test_faults kills a slave too; here the other side has a clock of its own
def test_a_killed_slave_frees_the_hand_and_the_next_one_waits_for_the_operator(
    tmp_path, demo_config
):
    elsewhere = AHEAD if os.geteuid() == 0 else ()
    with Processes(tmp_path, demo_config, RATE, *HELD) as session:
        session.start("record", "--out", str(tmp_path))
        session.start("slave")
        master = session.start("master", "--json", str(tmp_path / "master.json"), prefix=elsewhere)
        with session.look() as link:
            assert wait_for_condition(lambda: session.engaged(link), START_S), session.outputs()
            clocks = {os.readlink(f"/proc/{one}/ns/time") for one in ("self", master.pid)}
            assert len(clocks) == 1 + bool(elsewhere)
            pause(0.5)
            first = link.take_latest(STATE).message.sender
            session.kill("slave")
            pause(0.5)
            session.start("slave")
            assert wait_for_condition(
                lambda: link.take_latest(STATE).message.sender != first, START_S
            )
            pause(1.0)
        for name in ("master", "slave", "record"):
            session.stop(name)

        fields = ["log_time_ns", "sender", "state"]
        states = read_columns(session.recording(), STATE.name, fields)
        killed = states["sender"] == first
        last = states["log_time_ns"][killed].max()
        hand = read_columns(session.recording(), HAND.name, ["log_time_ns", "force", "state"])
        force = np.abs(hand["force"]).max(axis=1)
        after = hand["log_time_ns"] > last + LIMIT_NS
        assert force[hand["log_time_ns"] <= last].max() > 0.1  # it was felt until then
        assert after.sum() > 250  # the master went on for long enough to tell
        assert force[after].max() == 0.0
        assert not (hand["state"][after] == State.ENGAGED).any()
        assert (~killed).sum() > 100
        assert not (states["state"][~killed] == State.ENGAGED).any()
        assert session.summary("master")["final_state"] == "fault"
