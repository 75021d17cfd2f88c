"""One side is killed in the middle of a session; a recording tells what the other side did."""

import os

import numpy as np
import pytest

from teleop.launch.supervisor import wait_for_condition
from teleop.messages.topics import COMMAND, HAND, STATE, TENDONS
from teleop.recording.reader import read_columns
from teleop.session.state_machine import State
from tests.system.processes import START_S, Processes, pause

LIMIT_NS = 50_000_000  # what the other side has to be safe, counted from the last message sent


@pytest.fixture
def session(tmp_path, demo_config):
    with Processes(tmp_path, demo_config) as processes:
        processes.start_all()
        pause(0.5)
        yield processes


def test_the_hand_is_freed_when_the_slave_is_killed(session):
    session.kill("slave")
    pause(1.0)
    session.stop("master")
    session.stop("record")

    last = read_columns(session.recording(), STATE.name)["stamp_ns"].max()
    hand = read_columns(session.recording(), HAND.name)
    force = np.abs(hand["force"]).max(axis=1)
    before, after = hand["stamp_ns"] <= last, hand["stamp_ns"] > last + LIMIT_NS
    assert force[before].max() > 0.1  # it was felt until then
    assert after.sum() > 500  # the master went on for long enough to tell
    assert force[after].max() == 0.0
    assert not (hand["state"][after] == State.ENGAGED).any()


def test_the_slave_holds_when_the_master_is_killed(session):
    session.kill("master")
    pause(1.0)
    session.stop("slave")
    session.stop("record")

    last = read_columns(session.recording(), COMMAND.name)["stamp_ns"].max()
    rows = read_columns(session.recording(), TENDONS.name)
    asked = rows["commanded_displacement"][:, 0]
    before, after = rows["stamp_ns"] <= last, rows["stamp_ns"] > last + LIMIT_NS
    before &= np.isfinite(asked)  # NaN until the first engagement
    assert np.ptp(asked[before]) > 1e-4  # it moved until then
    assert after.sum() > 500
    assert np.ptp(asked[after]) == 0.0


@pytest.mark.skipif(os.geteuid() != 0, reason="only root has time namespaces")
def test_machines_started_at_other_times_make_a_session_and_the_hand_is_freed(
    tmp_path, demo_config
):
    """The master's monotonic clock is 11 days ahead, as of another machine."""
    ahead = ("unshare", "-T", "--monotonic", "1000000", "--boottime", "1000000", "--")
    with Processes(tmp_path, demo_config) as session:
        session.start("record", "--out", str(tmp_path))
        session.start("slave")
        master = session.start("master", prefix=ahead)
        with session.look() as link:
            assert wait_for_condition(lambda: session.engaged(link), START_S), session.outputs()
        clocks = {os.readlink(f"/proc/{one}/ns/time") for one in ("self", master.pid)}
        assert len(clocks) == 2
        pause(0.5)
        session.kill("slave")
        pause(1.0)
        session.stop("master")
        session.stop("record")

        last = read_columns(session.recording(), STATE.name, ["log_time_ns"])["log_time_ns"].max()
        hand = read_columns(session.recording(), HAND.name, ["log_time_ns", "force"])
        force = np.abs(hand["force"]).max(axis=1)
        after = hand["log_time_ns"] > last + LIMIT_NS
        assert force[hand["log_time_ns"] <= last].max() > 0.1
        assert after.sum() > 500
        assert force[after].max() == 0.0


def test_nothing_couples_again_until_the_operator_lets_go(tmp_path, demo_config):
    held = ("master.device.engage=[[0.5, 1000.0]]", "master.device.engage_period=.inf")
    with Processes(tmp_path, demo_config, *held) as session:
        session.start_all()
        session.kill("slave")
        pause(0.3)
        session.start("slave", "--json", str(tmp_path / "slave.json"))
        pause(10.0)  # it takes some seconds to come up
        session.stop("master")
        session.stop("slave")
        session.stop("record")

        states = read_columns(session.recording(), STATE.name)
        senders = states["sender"]
        again = senders != senders[0]
        assert again.sum() > 100  # the second slave was there
        assert not (states["state"][again] == State.ENGAGED).any()
        assert session.summary("master")["final_state"] == "fault"
