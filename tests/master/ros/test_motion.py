"""How a hand moves by the records of commands, without processes."""

import numpy as np
import pytest

from master.devices.commands import CommandMotion, CommandRecord

MS = 1_000_000
BEGIN = 10**12


def record(at_ms, number, engagement, *values):
    return CommandRecord(BEGIN, BEGIN + at_ms * MS, number, engagement, "", values)


def motion(**config):
    """One that was engaged at 5 mm, for the first time."""
    motion = CommandMotion(
        config.pop("axes", 1), config.pop("command", "servo_jp") == "servo_cv", **config
    )
    motion.step(record(0, 1, 0, 0.005), True, 0.0)
    motion.step(record(0, 1, 1, 0.005), True, 0.001)
    hand = motion.step(record(0, 1, 1, 0.005), True, 0.002)
    assert (hand.engage, hand.position) == (True, (0.005,))
    return motion


def test_it_moves_linearly_between_two_commands():
    moving = motion()
    hands = [moving.step(record(10, 2, 1, 0.007), True, 0.01 + k * 1e-3) for k in range(15)]
    positions = [hand.position[0] for hand in hands]
    np.testing.assert_allclose(positions, 0.005 + 0.0002 * np.minimum(range(15), 10), atol=1e-12)
    assert hands[5].velocity == pytest.approx((0.2,))
    assert hands[12].velocity == (0.0,)


@pytest.mark.parametrize("later_ms", [1, 50])
def test_a_new_engagement_begins_with_an_open_switch_at_the_new_position(later_ms):
    """The node sent `disable`, a far position and `enable` between two reads."""
    moving = motion()
    far = record(later_ms, 2, 2, 0.4)
    hand = moving.step(far, True, 0.003)
    assert (hand.engage, hand.position, hand.velocity) == (False, (0.4,), (0.0,))
    hand = moving.step(far, True, 0.004)
    assert (hand.engage, hand.position, hand.velocity) == (True, (0.4,), (0.0,))


def test_before_it_is_enabled_it_is_at_the_newest_command():
    moving = motion()
    moving.step(record(3, 2, 0, 0.4), True, 0.003)
    for k in range(4, 20):
        hand = moving.step(record(3, 2, 3, 0.4), True, k * 1e-3)
        assert (hand.position, hand.velocity) == ((0.4,), (0.0,))


def test_a_velocity_moves_while_engaged_and_fresh_only():
    moving = CommandMotion(1, is_velocity=True)
    positions = []
    for k, (engagement, is_fresh) in enumerate(
        [(0, True)] * 5 + [(1, True)] * 6 + [(1, False)] * 5
    ):
        hand = moving.step(record(0, 1, engagement, 0.1), is_fresh, k * 1e-3)
        positions.append(hand.position[0])
    np.testing.assert_allclose(positions, [0.0] * 6 + [1e-4 * k for k in range(1, 6)] + [5e-4] * 5)
    moving.step(record(0, 1, 1, 0.1), True, 0.02)
    assert (
        moving.step(record(0, 1, 1, 0.1), True, 5.0).position[0] < 3e-3
    )  # a loop that was held up
