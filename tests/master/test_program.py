"""A program as operator: both ends of the sockets, in one process."""

import itertools
import math
import os
import threading
import time

import pytest

from master.device import DeviceFault, DeviceLost
from master.devices.commands import CommandRecord
from master.devices.program import (
    SOCKET_VARIABLE,
    ProgramConfig,
    ProgramDevice,
    ProgramOperator,
)
from teleop.errors import TeleopError, UsageError


@pytest.fixture
def ends(monkeypatch):
    """The program's end, and the master's."""
    config = ProgramConfig(axes=2, timeout=0.2)
    operator = ProgramOperator(config)
    monkeypatch.setenv(SOCKET_VARIABLE, str(os.dup(operator.theirs.fileno())))
    device = ProgramDevice(config)
    operator.leave_master_end()  # as a session does once the master runs
    yield operator, device
    device.close()
    operator.close()


def test_before_the_program_says_anything_the_switch_is_open(ends):
    _, device = ends
    hand = device.read(0.0)
    assert (hand.position, hand.velocity, hand.engage) == ((0.0, 0.0), (0.0, 0.0), False)


def test_the_hand_moves_linearly_to_each_position_and_rests(ends):
    operator, device = ends
    operator.engage()
    device.read(0.0)
    assert device.read(0.001).engage
    time.sleep(0.02)
    operator.move([0.01, -0.02])
    hands = [device.read(0.001 * k) for k in range(2, 150)]
    steps = {round(b.position[1] - a.position[1], 9) for a, b in itertools.pairwise(hands)}
    assert min(steps) >= -0.02 / 10  # it took 20 ms and more
    assert hands[-1].position == (0.01, -0.02)
    assert hands[-1].velocity == (0.0, 0.0)
    assert all(hand.engage for hand in hands)


def test_each_press_of_a_button_is_held_for_one_read_and_moves_nothing(ends):
    operator, device = ends
    operator.engage()
    device.read(0.0)
    operator.press(2)
    operator.press(5)
    operator.move([0.0, 0.0])
    hands = [device.read(0.001 * k) for k in range(1, 4)]
    assert [hand.buttons for hand in hands] == [(2, 5), (), ()]
    assert all(hand.engage and hand.position == (0.0, 0.0) for hand in hands)
    for button in (0, 129, "2"):
        with pytest.raises(UsageError, match="must be 1 to 128"):
            operator.press(button)


def test_a_late_position_is_reached_within_a_tenth_of_a_second(ends):
    operator, device = ends
    operator.engage()
    device.read(0.0)
    device.read(0.001)
    time.sleep(0.15)
    operator.move([0.01, 0.0])
    assert device.read(1.0).position[0] < 0.002
    assert device.read(1.101).position[0] == 0.01


def test_silence_opens_the_switch_and_only_a_new_press_closes_it(ends):
    operator, device = ends
    operator.move([0.01, 0.0])
    operator.engage()
    device.read(0.0)
    assert device.read(0.001).engage
    time.sleep(0.25)
    assert not device.read(0.002).engage
    with pytest.raises(TeleopError, match=r"0.2 s.*engage\(\) again"):
        operator.move([0.5, 0.0])
    hand = device.read(0.003)
    assert (hand.engage, hand.position[0]) == (False, 0.01)
    operator.engage()
    assert not device.read(0.004).engage  # open between two engagements
    assert device.read(0.005).engage


def test_a_press_while_pressed_opens_it_first(ends):
    operator, device = ends
    operator.engage()
    device.read(0.0)
    assert device.read(0.001).engage
    operator.engage()
    assert [device.read(0.002).engage, device.read(0.003).engage] == [False, True]
    operator.release()
    assert not device.read(0.004).engage


def test_a_force_comes_back_with_each_command_and_none_piles_up(ends):
    operator, device = ends
    for k in range(5000):  # of a loop that nobody listens to
        device.write((float(k), 0.0))
    assert operator.force == (0.0, 0.0)
    operator.move([0.0, 0.0])
    device.read(0.0)
    device.write((1.5, -0.5))
    device.write((9.0, 9.0))
    assert operator.force == (1.5, -0.5)


@pytest.mark.parametrize("force", [(math.nan, 0.0), (math.inf, 0.0), (1.0,)])
def test_a_force_that_cannot_be_is_refused(ends, force):
    with pytest.raises(DeviceFault):
        ends[1].write(force)


def test_a_program_that_has_ended_is_a_lost_device(ends):
    operator, device = ends
    operator.engage()
    device.read(0.0)
    operator.close()
    for k in range(3):
        with pytest.raises(DeviceLost, match="has ended"):
            device.read(0.001 * k)
    device.write((1.0, 0.0))  # nobody is there; the loop goes on to its fault


def test_a_position_that_is_not_finite_never_reaches_the_hand(ends):
    operator, device = ends
    now_ns = time.monotonic_ns()
    operator._socket.send(CommandRecord(now_ns, now_ns, 1, 1, "", (math.nan, 0.0)).pack())
    with pytest.raises(DeviceLost, match="nan"):
        device.read(0.0)


def test_a_flood_of_commands_does_not_hold_a_tick_up_and_none_is_lost(ends):
    """The program waits for room; its last words arrive, too."""
    operator, device = ends

    def flood():
        operator.engage()
        for k in range(2000):
            operator.move([0.0001 * k, 0.0])
        operator.release()

    program = threading.Thread(target=flood)
    program.start()
    time.sleep(0.05)  # until there is no room
    begin, hand = device.read(0.0).position[0], None
    assert begin < 0.02  # some of them, not all at once
    for k in range(1, 400):
        hand = device.read(0.001 * k)
        if k % 10 == 0:
            device.write((float(k), 0.0))
        time.sleep(0.0002)
    program.join()
    for k in range(400, 600):
        hand = device.read(0.001 * k)
    assert (hand.engage, hand.position[0]) == (False, pytest.approx(0.1999))


def test_commands_that_come_in_bursts_move_the_hand_steadily(ends):
    """A program that reads states in blocks of 0.1 s moves once for each of them."""
    operator, device = ends
    operator.engage()
    device.read(0.0)
    device.read(0.001)
    now_ns, places = time.monotonic_ns(), []
    for burst in range(6):
        for k in range(100):
            sent_ns = now_ns + burst * 100_000_000 + k * 10_000
            place = 0.03 * (burst * 100 + k + 1) * 1e-3
            record = CommandRecord(sent_ns, sent_ns, 100 * burst + k + 2, 1, "", (place, 0.0))
            operator._socket.send(record.pack())
        for tick in range(100):
            hand = device.read(0.1 * burst + 0.001 * tick + 0.002)
            places.append(hand.position[0])
    speeds = [(b - a) / 0.001 for a, b in itertools.pairwise(places[100:])]
    assert max(speeds) < 0.04  # 0.03 m/s was asked for
    assert sum(speed < 0.001 for speed in speeds) < 0.1 * len(speeds)


def test_a_master_that_has_ended_is_noticed(ends):
    operator, device = ends
    device.close()
    for call in (lambda: operator.move([0.0, 0.0]), operator.engage, lambda: operator.force):
        with pytest.raises(TeleopError, match="the master's process has ended"):
            call()


@pytest.mark.parametrize(
    ("position", "words"),
    [([math.nan, 0.0], "finite"), ([0.0, 1.5], "within"), ([0.0], "1 numbers, must be 2")],
)
def test_the_program_is_told_what_is_wrong_with_a_position(ends, position, words):
    with pytest.raises(UsageError, match=words):
        ends[0].move(position)
