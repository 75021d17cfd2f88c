import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slave.simulation.environment import (
    LoadMotorConfig,
    TissueConfig,
    WallConfig,
    build_environment,
    compute_environment_force,
)

DT = 1e-3
PARTS = st.one_of(
    st.builds(
        WallConfig,
        position=st.floats(-0.01, 0.01),
        stiffness=st.floats(0, 1e5),
        damping=st.floats(0, 100),
        side=st.sampled_from("ab"),
    ),
    st.builds(
        TissueConfig,
        position=st.floats(-0.01, 0.01),
        stiffness=st.floats(0, 1e5),
        exponent=st.floats(1, 3),
        dissipation=st.floats(0, 100),
        side=st.sampled_from("ab"),
    ),
    st.builds(LoadMotorConfig, profile=st.just(((0.0, -3.0),))),
    st.builds(
        LoadMotorConfig,
        mode=st.just("position"),
        profile=st.just(((0.0, 0.003),)),
        stiffness=st.floats(0, 1e5),
    ),
)


def force(config, travel, before=None, time=0.0, dt=DT):
    before = travel if before is None else before
    return compute_environment_force(build_environment(config), travel, before, time, dt)


def test_a_wall_pushes_back_from_where_it_is_and_never_pulls():
    wall = WallConfig(position=0.004, stiffness=1000.0, damping=10.0)
    assert force(wall, 0.0039) == 0.0
    assert force(wall, 0.006) == pytest.approx(2.0)
    assert force(wall, 0.006, 0.0055) == pytest.approx(2.0 + 10.0 * 0.5)
    assert force(wall, 0.006, 0.007) == 0.0  # leaving at 1 m/s, it cannot follow
    assert force(wall, 0.006, 0.001) == pytest.approx(2.0 + 10.0 * 2.0)  # only the way inside


def test_tissue_that_is_left_faster_than_it_follows_does_not_pull():
    tissue = TissueConfig(position=0.0, dissipation=10.0)
    assert force(tissue, 0.004, 0.0045) == 0.0  # 0.5 m/s outwards
    assert 0.0 < force(tissue, 0.004, 0.00405) < force(tissue, 0.004)


def test_tissue_is_the_law_of_hunt_and_crossley_and_its_loop_dissipates():
    """Against the work that the continuous law takes on the same sine, by quadrature."""
    stiffness, n, depth, omega = 2e4, 1.5, 0.004, 20.0
    time = np.arange(0.0, 2.0 * math.pi / omega, 1e-5)
    travel = 0.5 * depth * (1.0 - np.cos(omega * time))
    works = []
    for dissipation in (0.0, 2.0, 8.0):
        tissue = build_environment(TissueConfig("tissue", 0.0, stiffness, n, dissipation))
        forces = np.array(
            [
                compute_environment_force(tissue, after, before, 0.0, 1e-5)
                for before, after in itertools.pairwise(travel)
            ]
        )
        works.append(float(forces @ np.diff(travel)))
        rate = 0.5 * depth * omega * np.sin(omega * time)
        law = stiffness * travel**n * (1.0 + dissipation * rate)
        assert law.min() >= 0.0
        assert works[-1] == pytest.approx(np.trapezoid(law * rate, time), abs=1e-5)
    assert abs(works[0]) < 1e-5 < works[1] < works[2]


@given(PARTS, st.floats(-0.02, 0.02), st.floats(-0.02, 0.02), st.floats(-0.02, 0.02))
def test_a_force_never_falls_with_travel(part, before, one, other):
    low, high = sorted((one, other))
    assert force(part, high, before) >= force(part, low, before) - 1e-9


@given(PARTS, st.floats(1e-5, 1e-2), st.lists(st.floats(-0.02, 0.02), min_size=2, max_size=12))
def test_no_way_round_gives_energy(part, dt, places):
    """There and back, in steps of any size: what comes out has been put in before."""
    environment = build_environment(part)
    work = 0.0
    for before, after in zip(places, [*places[1:], places[0]], strict=True):
        work += compute_environment_force(environment, after, before, 0.0, dt) * (after - before)
    assert work >= -1e-12


def test_a_profile_runs_straight_between_its_points_and_stays_or_repeats():
    points = ((1.0, 0.0), (2.0, 4.0), (3.0, 1.0))
    once = LoadMotorConfig(profile=points)
    again = LoadMotorConfig(profile=points, repeat=True)
    times = [0.0, 1.0, 1.25, 2.0, 2.5, 3.0, 9.0]
    assert [force(once, 0.0, time=t) for t in times] == [0, 0, 1, 4, 2.5, 1, 1]
    assert [force(again, 0.0, time=t) for t in (1.25, 3.25, 7.25)] == pytest.approx([1, 1, 1])
    brief = LoadMotorConfig(profile=points, coupled=(2.0, 2.5))
    assert [force(brief, 0.0, time=t) for t in (1.9, 2.0, 2.4, 2.5)] == pytest.approx(
        [0, 4, 2.8, 0]
    )


def test_a_load_motor_under_position_control_drives_through_its_stiffness():
    motor = LoadMotorConfig(mode="position", profile=((0.0, 0.002),), stiffness=5000.0)
    assert force(motor, 0.003) == pytest.approx(5.0)
    assert force(motor, 0.001) == pytest.approx(-5.0)
