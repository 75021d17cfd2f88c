"""A closed loop of two cables: its limits, and a simulation in time that shares nothing with it."""

import numpy as np
import pytest

from estimator.lumped.loop_model import simulate_loop
from estimator.lumped.loop_solver import WORK_ROWS, Line, solve_balance
from estimator.lumped.lumped_model import Physics
from estimator.lumped.nodes import NODES, build_even_weights
from studies.hidden_effects.loop import Loop, draw_motion, run

TIME = np.arange(800) / 50.0
TRAVEL = 3e-3 * np.sin(TIME) * np.cos(0.23 * TIME)
COMPLIANCE, TIP = 1.25e-4, 4e-4


def moved(travel=TRAVEL, K=0.5, pretension=20.0, time=TIME, **changes):
    physics = Physics(np.full(len(time), K), COMPLIANCE, build_even_weights(), TIP)._replace(
        **changes
    )
    return simulate_loop(physics, pretension, time, travel, np.gradient(travel, time))


def test_without_friction_it_is_two_springs_beside_each_other():
    out = moved(K=1e-9)
    assert out.proximal_tension == pytest.approx(out.distal_tension, abs=1e-6)
    assert out.proximal_tension == pytest.approx(TRAVEL / (COMPLIANCE / 2 + TIP), abs=1e-6)


@pytest.mark.parametrize("law", [{}, {"presliding": 2e-5}, {"K": 1e-3, "drag": 3e3}])
def test_both_ways_are_alike(law):
    one, other = moved(**law), moved(-TRAVEL, **law)
    assert one.proximal_tension == pytest.approx(-other.proximal_tension, abs=1e-6)
    assert one.distal_displacement == pytest.approx(-other.distal_displacement, abs=1e-9)


def test_a_way_there_and_back_costs_energy():
    time = np.arange(400) / 50.0
    there = 3e-3 * np.sin(2 * np.pi * np.clip(time, 1.0, 7.0) / 2.0)
    out = moved(there, time=time, presliding=1e-5)
    after = time > 1.0
    work = np.trapezoid(out.proximal_tension[after], there[after])
    passed_on = np.trapezoid(out.distal_tension[after], out.distal_displacement[after])
    assert work > passed_on > -1e-6


@pytest.mark.parametrize(
    "loop",
    [
        Loop(K=0.5, spring=0.0),
        Loop(K=0.0, friction=3.0, give=2e-5),
        Loop(K=0.4, friction=1.0, pretension=3.0),
    ],
    ids=["capstan, held", "load-independent", "both, slack"],
)
def test_a_simulation_in_time_agrees(loop):
    time, angle = draw_motion(3, duration=12.0, rate=50.0)
    torque, at_tip, turned = run(loop, time, angle)
    K = max(loop.K, 1e-3)
    out = moved(
        angle * loop.radius,
        K,
        loop.pretension,
        time,
        drag=loop.friction / K,
        presliding=loop.give,
        tip_compliance=1.0 / loop.spring if loop.spring else 0.0,
        compliance=1.0 / loop.stiffness,
    )
    full = np.ptp(torque)
    assert np.std(out.proximal_tension * loop.radius - torque) < 0.012 * full
    assert np.std(out.distal_tension * loop.radius - at_tip) < 0.012 * full
    assert np.std(out.distal_displacement / loop.radius - turned) < 0.012 * np.ptp(angle)


def test_the_balance_with_a_slack_cable_is_found():
    n = 2 * NODES - 1
    friction, bristle = np.full(n, 0.05), np.full(n, 2.0)
    line = Line(
        0.1, np.full(n + 1, 2e3), friction, np.zeros(n), bristle, np.zeros(n), False,
        NODES - 1, False, 0.0, 10.0, 0.0,
    )  # fmt: skip
    state = [np.zeros(n) for _ in range(4)]
    tension, work = np.full(n + 1, 0.1), np.empty((WORK_ROWS, n))
    places, force, sliding, trial = state
    for drive in -0.05 * np.sin(np.arange(1, 300) / 30.0):
        trial[:] = places
        assert solve_balance(line, drive, places, force, sliding, trial, tension, work)
        places[:] = trial
    assert (tension[:NODES] < 0.0).all() or (tension[NODES:] < 0.0).all()
