"""The emergency stop of a running session, from outside; what it did is read from a recording."""

import io
import signal
import subprocess
import tempfile
from contextlib import contextmanager, redirect_stderr, redirect_stdout

import numpy as np
import pytest

from studies.testbed.processes import START_S, Processes, pause, wait_for_condition
from teleop.cli import commands
from teleop.messages.topics import COMMAND, EVENT, HAND, STATE, STOP, TENDONS, Role
from teleop.recording.reader import read_columns
from teleop.session.state_machine import Reason, State
from tests.system.flood import flooded

HELD = (
    "rate_hz=250",
    *("master.device.engage=[[0.5, 1000.0]]", "master.device.engage_period=.inf"),
    # on a busy machine a silence that is not meant would end the session
    *("master.state_timeout=0.5", "master.delay_max=1.0", "slave.command_timeout=0.5"),
    "health={loss: 1.0, round_trip: 10.0, jitter: 10.0}",  # and late messages scale motion down
)
LIMIT_NS = 50_000_000  # from the call heard by the recorder to no force and no motion


def asked(session, *words):
    """Run a command of the session here; return its exit code and what it printed."""
    said = io.StringIO()
    with redirect_stdout(said), redirect_stderr(said):
        code = commands.main([*words, *session.shared])
    return code, said.getvalue()


@contextmanager
def looking(session):
    """A link that has heard both sides, if both are there."""
    with session.look() as link:
        for topic in (COMMAND, STATE):
            link.subscribe_latest(topic)
        wait_for_condition(lambda: None not in states(link), 0.5)
        yield link


def states(link):
    newest = [link.take_latest(topic).message for topic in (COMMAND, STATE)]
    return [None if message is None else message.state for message in newest]


def columns(session, topic):
    return read_columns(session.recording(), topic.name)


def assert_safe_after(session, when):
    """No force and no motion from `LIMIT_NS` after `when` [ns] on."""
    hand, tendons = columns(session, HAND), columns(session, TENDONS)
    late = hand["stamp_ns"] > when + LIMIT_NS
    assert late.sum() > 100
    assert np.abs(hand["force"][late]).max() == 0.0
    assert np.abs(hand["force"][hand["stamp_ns"] <= when]).max() > 0.1
    asked_for = tendons["commanded_displacement"][:, 0]
    assert np.ptp(asked_for[tendons["stamp_ns"] > when + LIMIT_NS]) == 0.0


def end(session):
    for name in ("master", "slave", "record"):
        session.stop(name)


def test_settings_change_without_a_jump_and_a_stop_is_latched_until_reset_past_any_flood(
    tmp_path, demo_config
):
    with Processes(tmp_path, demo_config, *HELD) as session:
        session.start_all()
        pause(0.5)
        assert asked(session, "set", "force.scale", "0.4") == (0, "force.scale = 0.4\n")
        code, text = asked(session, "set", "operator.position_scale", "0.1")
        assert (code, text) == (0, "operator.position_scale = 0.1\n")
        code, text = asked(session, "set", "force.limit", "9")
        assert code == 2
        assert "cannot be changed while the master runs" in text
        pause(1.0)

        code, text = asked(session, "stop", "--why", "a test")
        assert code == 0, text
        assert text.split() == ["master", "stopped", "slave", "stopped"]
        with looking(session) as link:
            assert wait_for_condition(lambda: states(link) == [State.STOPPED] * 2, 2.0)
            pause(0.5)
            assert states(link) == [State.STOPPED] * 2
            code, text = asked(session, "stop", "--reset")
            assert code == 0, text
            pause(0.5)
            assert states(link) == [State.READY] * 2  # the switch is held, and was not let go of
            assert link.take_latest(COMMAND).message.reason == Reason.RELEASE_FIRST
            watch = session.start("stop", "--watch")
            log = max(tmp_path.glob("*-stop.log"), key=lambda path: path.stat().st_ctime_ns)
            assert wait_for_condition(lambda: "watching master and slave" in log.read_text(), 30.0)
            assert states(link) == [State.READY] * 2
            watch.kill()
            assert wait_for_condition(lambda: states(link) == [State.STOPPED] * 2, 2.0)
            code, text = asked(session, "stop", "--reset")
            assert code == 0, text

        config = session.link_config
        with flooded([config.master, config.slave]):
            for words in ([], ["--reset"], ["--why", "\udcff"]):
                code, text = asked(session, "stop", *words)
                assert code == 0, text
        end(session)
        assert_safe_after(session, columns(session, STOP)["stamp_ns"].min())
        events = columns(session, EVENT)
        for role in (Role.MASTER, Role.SLAVE):
            told = events[events["role"] == role]
            resets = np.flatnonzero(told["reason"] == Reason.RESET)
            stops = np.flatnonzero(told["state"] == State.STOPPED)
            assert len(resets) == 3
            assert (stops < resets[0]).sum() == 1
            assert stops[-1] > resets[2]
            # whichever came first
            why = set(told["reason"][stops])
            assert why <= {Reason.STOP_CALLED, Reason.WATCH_LOST, Reason.PEER_STOPPED}
        assert_follows_by_one_scale_or_the_other(session)


def assert_follows_by_one_scale_or_the_other(session):
    """The tip follows the hand by the scale before or after, in every tick of whatever length."""
    command, hand = columns(session, COMMAND), columns(session, HAND)
    hand = hand[hand["state"] == State.ENGAGED]
    # the command of each tick: the last one before the hand is published
    command = command[np.searchsorted(command["stamp_ns"], hand["stamp_ns"]) - 1]
    assert (command["state"] == State.ENGAGED).all()
    next_tick = (np.diff(command["sequence"]) == 1) & (np.diff(hand["sequence"]) == 1)
    tip, moved = (np.abs(np.diff(row["position"][:, 0]))[next_tick] for row in (command, hand))
    assert (tip <= 0.25 * moved + 1e-9).all()
    moving = moved > 1e-6
    scales = tip[moving] / moved[moving]  # while the hand is not at rest
    assert len(scales) > 100
    assert scales[:10] == pytest.approx(0.25, rel=1e-3)  # the change follows soon
    assert scales[-50:] == pytest.approx(0.1, rel=1e-3)


@pytest.mark.slow
def test_a_stop_goes_through_a_watch_of_its_machine_when_the_ports_are_busy(tmp_path, demo_config):
    """The sides are as if on other machines: their sockets cannot be seen."""
    with (
        tempfile.TemporaryDirectory(dir="/tmp") as rig,
        tempfile.TemporaryDirectory(dir="/tmp") as desk,
        Processes(tmp_path, demo_config, *HELD) as session,
    ):
        at_desk = ["env", f"XDG_RUNTIME_DIR={desk}"]
        session.start_all(prefix=["env", f"XDG_RUNTIME_DIR={rig}"])
        session.start("stop", "--watch", prefix=at_desk)
        log = tmp_path / "3-stop.log"
        assert wait_for_condition(lambda: "watching master and slave" in log.read_text(), START_S)
        config = session.link_config
        with flooded([config.master, config.slave]):
            stop = session.start("stop", prefix=at_desk)
            assert stop.wait(30) == 0, session.outputs()
        end(session)
        events = columns(session, EVENT)
        told = events["role"][events["state"] == State.STOPPED]
        assert set(told) == {Role.MASTER, Role.SLAVE}


@pytest.mark.slow
def test_a_side_elsewhere_that_hangs_is_named_and_no_success(tmp_path, demo_config):
    """The sides are as if on two machines; the slave is suspended and answers nobody."""
    with (
        tempfile.TemporaryDirectory(dir="/tmp") as rig,
        tempfile.TemporaryDirectory(dir="/tmp") as desk,
        Processes(tmp_path, demo_config, *HELD) as session,
    ):
        slave = session.start("slave", prefix=["env", f"XDG_RUNTIME_DIR={rig}"])
        session.start("master", prefix=["env", f"XDG_RUNTIME_DIR={desk}"])
        with session.look() as link:
            assert wait_for_condition(lambda: session.engaged(link), START_S), session.outputs()
        slave.send_signal(signal.SIGSTOP)
        pause(1.5)
        stop = session.start("stop", prefix=["env", f"XDG_RUNTIME_DIR={desk}"])
        code = stop.wait(30)
        slave.send_signal(signal.SIGCONT)
        text = sorted(tmp_path.glob("*-stop.log"))[-1].read_text()
        assert code == 1, text
        assert "master    stopped" in text
        assert "the slave" in text.splitlines()[-1]


@pytest.mark.slow
def test_nobody_there_is_told_and_a_slave_without_a_master_is_stopped_and_reset(
    tmp_path, demo_config
):
    with Processes(tmp_path, demo_config) as session:
        code, text = asked(session, "stop")
        assert code == 1
        assert "no answer from master or slave" in text
        assert len(text.splitlines()) == 1
        session.start("slave")
        with looking(session) as link:
            assert wait_for_condition(lambda: states(link)[1] is not None, START_S)
            code, text = asked(session, "stop")
            assert (code, text.split()) == (0, ["slave", "stopped"])
            assert wait_for_condition(lambda: states(link)[1] == State.STOPPED, 2.0)
            code, text = asked(session, "stop", "--reset")
            assert code == 0
            assert "slave     ready" in text


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP, signal.SIGTERM])
def test_a_watch_that_leaves_stops_nothing_and_the_end_of_one_stops_both_sides(
    tmp_path, demo_config, how
):
    with Processes(tmp_path, demo_config, *HELD) as session:
        session.start_all()
        leaving = subprocess.Popen(
            [*session.running["slave"].args[:3], "stop", *session.shared, "--watch"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        with looking(session) as link:
            assert "watching" in leaving.stdout.readline()
            pause(0.5)
            out, _ = leaving.communicate("q\n", timeout=10)
            assert (leaving.returncode, out) == (0, "")
            pause(0.5)
            assert states(link) == [State.ENGAGED] * 2
            watch, log = session.start("stop", "--watch"), tmp_path / "3-stop.log"
            watching = "watching master and slave"
            assert wait_for_condition(lambda: watching in log.read_text(), START_S)
            pause(0.5)
            assert states(link) == [State.ENGAGED] * 2  # a watch that beats stops nothing
            watch.send_signal(how)
            assert wait_for_condition(lambda: states(link) == [State.STOPPED] * 2, 2.0)
        pause(0.7)
        end(session)
        events = columns(session, EVENT)
        stopped = events[events["state"] == State.STOPPED]
        assert set(stopped["role"][:2]) == {Role.MASTER, Role.SLAVE}
        assert_safe_after(session, stopped["stamp_ns"].min())
