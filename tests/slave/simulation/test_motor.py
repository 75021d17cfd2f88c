import math

import numpy as np
import pytest

from slave.simulation.motor import MotorConfig, advance_motor, build_motor, init_motor

DEFAULT = build_motor(MotorConfig(), 0.0)


def moved(motor, target, tension=lambda _: 0.0, seconds=1.0, dt=1e-3, state=None):
    """Follow `target(t)` against `tension(position)`; return positions and speeds."""
    state = state or init_motor()
    rows = []
    for k in range(round(seconds / dt)):
        state = advance_motor(motor, state, target((k + 1) * dt), tension(state.position), dt)
        rows.append((state.position, state.speed))
    return np.array(rows).T, state


def test_a_small_step_is_critically_damped():
    """x'' + 2 a x' + a^2 x = a^2 target with a = 2 bandwidth; the error falls with the step."""
    target, a = 1e-6, 200.0
    errors = []
    for dt in (4e-5, 1e-5):
        (position, _), _ = moved(DEFAULT, lambda _: target, seconds=0.05, dt=dt)
        time = np.arange(1, len(position) + 1) * dt
        exact = target * (1.0 - (1.0 + a * time) * np.exp(-a * time))
        errors.append(np.abs(position - exact).max() / target)
        assert position.max() <= target * (1.0 + 1e-9)
    assert errors[1] < 0.004
    assert errors[1] == pytest.approx(errors[0] / 4.0, rel=0.1)


@pytest.mark.parametrize("dt", [1e-3, 0.1])
def test_no_step_of_time_is_too_long(dt):
    (position, speed), _ = moved(DEFAULT, lambda _: 5e-3, seconds=2.0, dt=dt)
    assert np.abs(speed).max() <= DEFAULT.speed_max
    assert position.max() < 5e-3 + DEFAULT.speed_max * min(dt, 1e-3)
    assert position[-1] == pytest.approx(5e-3, abs=1e-7)


def test_it_goes_no_faster_than_its_voltage_allows_and_slower_under_load():
    for load in (0.0, 100.0, 200.0):
        (_, speed), _ = moved(DEFAULT, lambda _: 1.0, lambda _, load=load: load, seconds=1.0)
        allowed = DEFAULT.speed_max * (1.0 - load / DEFAULT.force_stall)
        assert speed.max() == pytest.approx(allowed, rel=0.01)
        assert speed.max() <= allowed * (1.0 + 1e-9)


def test_it_stalls_where_the_tendon_pulls_as_hard_as_it_can():
    stiff = 200_000.0

    def tendon(position):
        return max(0.0, stiff * position)

    # it swings about its limit: a mass on a spring, and no controller that could damp it
    (position, _), _ = moved(DEFAULT, lambda _: 1.0, tendon, seconds=1.2)
    assert stiff * position[300:].mean() == pytest.approx(DEFAULT.force_peak, rel=0.05)
    (position, _), state = moved(DEFAULT, lambda _: 1.0, tendon, seconds=60.0)
    warm = stiff * position[-20_000:]
    assert warm.mean() == pytest.approx(DEFAULT.force_rated, rel=0.05)
    assert state.heat == pytest.approx(1.0, abs=0.1)


def test_it_yields_a_little_to_the_tendon_but_not_to_the_tension_it_started_with():
    stiffness = DEFAULT.mass * DEFAULT.speed_gain * DEFAULT.position_gain
    (position, _), _ = moved(DEFAULT, lambda _: 0.0, lambda _: 20.0)
    assert position[-1] == pytest.approx(-20.0 / stiffness)
    held = build_motor(MotorConfig(), 20.0)
    (position, _), _ = moved(held, lambda _: 0.0, lambda _: 20.0)
    assert np.abs(position).max() < 1e-15


def test_backlash_shows_only_where_nothing_pulls():
    motor = build_motor(MotorConfig(backlash=0.05), 0.0)  # 0.5 mm of tendon
    wave = lambda t: 2e-3 * math.sin(6.0 * t)  # noqa: E731

    def pulleys(tension):
        state, rows = init_motor(), []
        for k in range(2000):
            state = advance_motor(motor, state, wave(k * 1e-3), tension, 1e-3)
            rows.append((state.position, state.pulley))
        return np.array(rows).T

    position, pulley = pulleys(1.0)
    assert np.array_equal(position, pulley)
    position, pulley = pulleys(0.0)
    lag = pulley - position
    assert lag.min() >= 0.0
    assert lag.max() == pytest.approx(0.05 * 0.010)
    falling = np.diff(position) < 0.0
    free = falling & (lag[1:] < 0.05 * 0.010 * (1 - 1e-9))
    assert free.any()
    assert np.all(np.diff(pulley)[free] == 0.0)  # it stays while the gear crosses its play
