import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from master.device import DeviceFault
from master.devices.virtual import Hold, Reaches, Sine, VirtualConfig, VirtualDevice, advance_hand

REFERENCES = [Hold(0.01), Sine(offset=0.02, frequency=3.0), Reaches()]


@pytest.mark.parametrize("reference", REFERENCES, ids=repr)
def test_the_velocity_of_a_reference_is_the_slope_of_its_position(reference):
    times = np.linspace(0.05, 12.0, 4001)
    h = 1e-6
    slopes = [
        (reference.compute_motion(t + h)[0] - reference.compute_motion(t - h)[0]) / (2 * h)
        for t in times
    ]
    assert [reference.compute_motion(t)[1] for t in times] == pytest.approx(slopes, abs=1e-4)


def test_reaches_visit_every_target_and_rest_there():
    reaches = Reaches(targets=(0.02, -0.01, 0.03), reach=0.6, rest=0.4)
    assert reaches.compute_motion(0.0) == (0.0, 0.0)
    for lap in range(2):
        for number, target in enumerate(reaches.targets):
            end = 3 * lap + number + 1
            for time in (end - 0.4 + 1e-9, end - 0.2, end - 1e-9):
                assert reaches.compute_motion(time) == pytest.approx((target, 0.0), abs=1e-12)


def test_the_hand_moves_as_its_equation_says():
    config = VirtualConfig(mass=0.3, stiffness=300.0, damping=10.0, reference=Sine())
    device = VirtualDevice(config)
    force = -1.5
    trace = []
    for tick in range(1, 2001):
        device.write((force,))
        trace.append(device.read(tick * 1e-3).position[0])

    def newton(t, y):
        target, speed = 0.02 * math.sin(math.pi * t), 0.02 * math.pi * math.cos(math.pi * t)
        pull = 300.0 * (target - y[0]) + 10.0 * (speed - y[1])
        return [y[1], (pull + force) / 0.3]

    times = np.arange(1, 2001) * 1e-3
    start = [0.0, 0.02 * math.pi]
    truth = solve_ivp(newton, (0.0, 2.0), start, t_eval=times, rtol=1e-9, atol=1e-12).y[0]
    assert np.abs(np.array(trace) - truth).max() < 1e-4  # of 20 mm travel, 5 mm deflection


def test_the_way_of_the_hand_does_not_hang_on_how_often_it_is_read():
    often, seldom = (VirtualDevice(VirtualConfig()) for _ in range(2))
    for tick in range(1, 401):
        often.write((2.0,))
        hand = often.read(tick * 1e-3)
        if tick % 10 == 0:
            seldom.write((2.0,))
            assert seldom.read(tick * 1e-3).position == pytest.approx(hand.position, abs=1e-9)


@given(
    st.floats(0.001, 10.0),
    st.floats(0.0, 1e5),
    st.floats(0.0, 1e4),
    st.lists(st.floats(1e-5, 0.01), min_size=1, max_size=200),
)
def test_left_alone_it_never_gains_energy_at_any_step(mass, stiffness, damping, steps):
    config = VirtualConfig(mass=mass, stiffness=stiffness, damping=damping, reference=Hold())
    x, v = 0.01, -0.3
    energy = 0.5 * mass * v * v + 0.5 * stiffness * x * x
    for h in steps:
        x, v = advance_hand(config, x, v, 0.0, 0.0, h)
        now = 0.5 * mass * v * v + 0.5 * stiffness * x * x
        assert now <= energy * (1 + 1e-9)
        energy = now


def test_the_watchdog_lets_go_when_writes_cease_even_within_one_read():
    device = VirtualDevice(VirtualConfig(reference=Hold(), damping=30.0))
    device.write((3.0,))
    device.read(0.049)
    assert device.applied == (3.0,)
    device.read(0.052)
    assert device.applied == (0.0,)
    gap = VirtualDevice(VirtualConfig(reference=Hold(), damping=30.0))
    gap.write((3.0,))
    assert abs(gap.read(1.0).position[0]) < 1e-4


def test_engage_follows_the_script():
    once = VirtualDevice(VirtualConfig(engage=((0.5, 1.0), (1.2, math.inf))))
    assert [once.read(t).engage for t in (0.4, 0.5, 0.99, 1.0, 1.2, 1e6)] == [
        False, True, True, False, True, True,
    ]  # fmt: skip
    again = VirtualConfig(engage=((0.5, 1.5),), engage_period=2.0)
    assert [again.is_pressed(t) for t in (0.0, 0.6, 1.6, 2.4, 2.6, 3.6)] == [
        False, True, False, False, True, False,
    ]  # fmt: skip


@pytest.mark.parametrize("force", [(math.nan,), (math.inf,), (0.0, 0.0), ()])
def test_what_the_gate_would_never_send_is_a_fault(force):
    with pytest.raises(DeviceFault):
        VirtualDevice(VirtualConfig()).write(force)


def test_closing_lets_go():
    device = VirtualDevice(VirtualConfig())
    device.write((1.0,))
    device.read(0.001)
    device.close()
    assert device.applied == (0.0,)
