import numpy as np
import pytest

from teleop.cli.simulate import (
    MOTIONS,
    MotionSample,
    MotionScale,
    MotionState,
    Sine,
    TensionHold,
    Turns,
)


def swings(motion, stiffness, seconds=60.0, dt=0.001):
    """Move a spring by `motion`; return time, position and force."""
    memory, target, rows = MotionState(), 0.0, []
    for k in range(int(seconds / dt)):
        rows.append((k * dt, target, stiffness * target))
        target, memory = motion.step(memory, MotionSample(k * dt, stiffness * target, dt))
    return np.array(rows).T


def test_turns_reach_each_level_in_order_at_constant_speed():
    motion = Turns((20.0, 4.0, 12.0), 0.004)
    _, position, force = swings(motion, 2000.0)
    assert np.abs(np.diff(position)) == pytest.approx(0.004 * 0.001)
    turning = np.flatnonzero(np.diff(np.sign(np.diff(position)))) + 1
    assert force[turning[:7]] == pytest.approx([20, 4, 20, 4, 20, 4, 20], abs=0.02)


def test_the_papers_motion_turns_at_a_quarter_of_the_peak():
    motion = MOTIONS["pull-release-pull"](MotionScale(peak=20.0, speed=0.004))
    _, position, force = swings(motion, 2000.0)
    turning = np.flatnonzero(np.diff(np.sign(np.diff(position)))) + 1
    assert force[turning[:4]] == pytest.approx([20, 5, 20, 5], abs=0.02)


def test_nested_swings_shrink_and_start_again():
    motion = MOTIONS["nested"](MotionScale(peak=20.0, speed=0.004))
    _, position, force = swings(motion, 2000.0)
    levels = force[np.flatnonzero(np.diff(np.sign(np.diff(position)))) + 1]
    assert np.all(np.diff(np.abs(np.diff(levels[:6]))) < 0)
    assert levels[6:12] == pytest.approx(levels[:6], abs=0.02)


def test_the_sine_starts_at_rest_and_returns():
    time, position, _ = swings(Sine(0.010, 4.0), 1.0, 8.0)
    assert position[0] == 0.0
    assert position.max() == pytest.approx(0.010, rel=1e-4)
    assert np.interp([4.0], time, position) == pytest.approx(0.0, abs=1e-6)
    assert abs(np.diff(position)[0]) < 1e-8


def test_keep_comes_to_its_tension_from_either_side_and_stays_within_its_speed():
    for offset in (-0.01, 0.01):  # slack, and pulled hard
        memory, target, forces, speeds = MotionState(target=offset), offset, [], []
        for k in range(2000):
            forces.append(max(0.0, 1000.0 * target))
            new, memory = TensionHold(0.5, 0.04).step(
                memory, MotionSample(k * 1e-3, forces[-1], 1e-3)
            )
            speeds.append(abs(new - target) / 1e-3)
            target = new
        assert forces[-1] == pytest.approx(0.5, abs=0.11)
        assert max(speeds) <= 0.04 * (1 + 1e-9)
