"""A rig on the firmware's own protocol code, over a pty: what moves, what stops, what is said."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from slave.bring_up import command
from slave.drivers import driver_table, worker
from slave.drivers.driver import Channels, DriverFault
from slave.drivers.microcontroller import driver, frames
from slave.drivers.microcontroller.driver import MicrocontrollerDriver
from slave.rig import RigFault
from slave.rigs.hardware import HardwareRig
from studies.rigs.models.board import (
    ENABLED,
    STOPPED,
    WATCHDOG,
    Board,
    Firmware,
)
from studies.rigs.models.line import PseudoPort
from studies.rigs.models.plant import METRES, NEWTONS, ZERO
from tests.drivers.bench import (
    engage,
    follow,
    microcontroller,
    opened,
    read_for,
    read_some,
    rig_config,
    running,
    wait_until,
)


@pytest.fixture
def board(library):
    with running(Board(library, motors=2, cells=2)) as board:
        yield board


def moving(board):
    return lambda: board.flags & ENABLED


def opened_on(board, **settings):
    return opened(rig_config(microcontroller(board.port.name, **settings), count=2))


def test_motors_follow_through_signals_and_announced_pauses_and_stop_when_told_or_left(board):
    with opened_on(board) as rig:
        start = engage(rig, moving(board))
        sample = follow(rig, start + 0.001)
        assert sample.proximal_tension == pytest.approx([3.0, 3.0], abs=0.3)
        told = command.format_counts(rig)
        motor, cell = (float(word) for word in re.findall(r"at (\d+)", told[1]))
        assert motor == pytest.approx(ZERO + 0.001 / METRES, abs=1e-4 / METRES)
        assert cell * NEWTONS == pytest.approx(3.0, abs=0.3)
        times = [sample.time_s for sample in read_some(rig, 50)]
        assert np.all(np.diff(times) > 0.0)
        # signals to the whole terminal; the slave still has to lower the tensions
        for number, moved in ((signal.SIGINT, 0.0), (signal.SIGTERM, 0.001), (signal.SIGHUP, 0.0)):
            os.kill(rig.buses[0].pid, number)
            follow(rig, start + moved)
        rig.announce_pause()
        time.sleep(4 * worker.TARGET_TIMEOUT_S)
        assert board.flags & ENABLED
        for moved in (0.001, 0.0):
            follow(rig, start + moved)
        rig.emergency_stop()
        assert wait_until(lambda: not board.flags & ENABLED)
        read_some(rig)  # the encoders are read on
        assert not board.flags & ENABLED
        engage(rig, moving(board), start)
        read_for(rig, 4 * worker.TARGET_TIMEOUT_S)  # a loop that only reads does not hang
        assert board.flags & ENABLED
        time.sleep(4 * worker.TARGET_TIMEOUT_S)
        with pytest.raises(RigFault, match=r"the slave has given no target for 0\.2 s"):
            read_for(rig, 5.0)
        assert wait_until(lambda: not board.flags & ENABLED)


def test_nothing_is_enabled_before_the_first_target_and_targets_that_are_none_are_refused(board):
    with opened_on(board) as rig:
        with pytest.raises(RigFault, match="no position of every motor is known"):
            rig.write(np.zeros(2))
        read_some(rig)
        assert not board.flags & ENABLED
        with pytest.raises(RigFault, match="first target of tendon 2"):
            rig.write(np.array([0.0, 0.01]))
        for targets in ([np.nan, 0.0], [0.0], [0.0, np.inf]):
            with pytest.raises(RigFault, match="invalid motor targets"):
                rig.write(np.array(targets))
        assert not board.flags & ENABLED


def test_a_killed_driver_leaves_the_motors_to_the_board_which_stops_them(board):
    with opened_on(board) as rig:
        engage(rig, moving(board))
        killed_s = time.monotonic()
        os.kill(rig.buses[0].pid, signal.SIGKILL)
        assert wait_until(lambda: board.flags & WATCHDOG)
        assert board.stopped_s > killed_s
        with pytest.raises(RigFault, match="has ended"):
            read_for(rig, 5.0)
    with opened_on(board) as rig:  # the board is there again, and moves nothing by itself
        read_some(rig)
        assert not board.flags & ENABLED


SLAVE = """
import sys
from tests.drivers.bench import engage, microcontroller, opened, read_for, rig_config

with opened(rig_config(microcontroller(sys.argv[1]), count=2)) as rig:
    target = engage(rig, lambda: True)
    print(flush=True)
    read_for(rig, 100.0, target)
"""


def test_the_motors_of_a_suspended_slave_are_stopped_by_the_driver(board):
    words = [sys.executable, "-c", SLAVE, board.port.name]
    with subprocess.Popen(words, stdout=subprocess.PIPE) as slave:
        try:
            slave.stdout.readline()
            assert wait_until(moving(board))
            slave.send_signal(signal.SIGSTOP)
            assert wait_until(lambda: not board.flags & ENABLED, worker.PAUSE_TIMEOUT_S / 2)
            assert board.flags & STOPPED
            assert not board.flags & WATCHDOG
        finally:
            slave.kill()


@pytest.mark.parametrize(
    ("cause", "said"),
    [
        ({"silent": True}, "silent for"),
        pytest.param(
            {"flip": 200}, "damaged or lost frames within a second", marks=pytest.mark.slow
        ),
        ({"ended": True}, "unplugged"),
    ],
)
def test_a_failure_is_named_and_the_motors_stop(board, cause, said):
    with opened_on(board) as rig:
        engage(rig, moving(board))
        for name, value in cause.items():
            setattr(board, name, value)
        rig.announce_pause()  # a busy machine may keep this process from writing in time
        with pytest.raises(RigFault, match=said):
            read_for(rig, 5.0)
        assert board.ended or wait_until(lambda: not board.flags & ENABLED)


def test_a_board_that_restarts_is_a_fault_and_moves_nothing(board, library):
    with opened_on(board) as rig:
        start = engage(rig, moving(board))
        board.firmware = Firmware(library, motors=2, cells=2)
        with pytest.raises(RigFault, match="stopped the motors by itself: it has restarted"):
            read_for(rig, 5.0, start)
        assert not board.flags & ENABLED


def test_a_board_with_another_watchdog_than_asked_for_is_refused(board, monkeypatch):
    parse = frames.parse_info
    monkeypatch.setattr(frames, "parse_info", lambda body: parse(body)._replace(watchdog_ms=500))
    driver = MicrocontrollerDriver(microcontroller(board.port.name), Channels((1,), (1,)))
    said = "watchdog is 500 ms, 40 ms was asked for"
    with pytest.raises(DriverFault, match=said), contextlib.closing(driver):
        driver.start()


@pytest.mark.slow
def test_a_few_damaged_frames_cost_their_samples_and_nothing_else(board):
    with opened_on(board) as rig:
        engage(rig, moving(board))
        board.flip = 3

        def bad():
            return rig.summarise().get("motors_bad_frames") == 3

        read_for(rig, 5.0, [0.0, 0.0], until=bad)
        assert bad()


@pytest.mark.parametrize("read_only", [False, True])
def test_a_board_that_says_nothing_is_asked_for_its_firmware(monkeypatch, read_only):
    for name in ("GREETING_S", "LISTEN_S"):
        monkeypatch.setattr(driver, name, 0.1)
    port = PseudoPort()
    silent = driver_table.open_driver(microcontroller(port.name), Channels((1,), (1,), read_only))
    said = "is the firmware of firmware/ on the board, and the baud rate right?"
    with pytest.raises(DriverFault, match=re.escape(said)), contextlib.closing(silent):
        silent.start()
    port.unplug()


def test_read_only_listens_and_sends_nothing(board):
    received = []
    take = board.firmware.receive

    def receive(data, *now):
        received.append(data)
        take(data, *now)

    board.firmware.receive = receive
    rig = HardwareRig(rig_config(microcontroller(board.port.name), count=2), read_only=True)
    sample = read_some(rig)[-1]
    rig.close()
    assert sample.proximal_displacement == pytest.approx([0.0, 0.0], abs=5e-5)
    assert b"".join(received) == b""
    config = rig_config(microcontroller(board.port.name), count=3)
    with pytest.raises(RigFault, match="has 2 motors, there is no motor 3"):
        HardwareRig(config, read_only=True)
