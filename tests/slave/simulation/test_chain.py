"""The chain against the laws it is made of, and against limits that need no theory of sheaths."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from slave.sheath_section import SectionConfig
from slave.simulation.chain_step import compute_response
from slave.simulation.friction_nodes import interpolate_curve
from slave.simulation.tendon import (
    CREEP,
    FRICTION,
    POSITION,
    RIGID_STIFFNESS,
    TENSION,
    Chain,
    SheathConfig,
    TendonDeviations,
    build_chain,
    get_tensions,
    init_chain_state,
)
from studies.brute_force import chain as brute
from tests.slave.tendon_bench import (
    BLOCKED,
    EA,
    SPRING,
    L,
    Load,
    distal,
    drive,
    ends,
    proximal,
    stretch,
    travels,
    turned,
    uniform,
)

EXACT = {
    "plain": {},
    "friction": {"friction_scale": 1.4, "asymmetry": 0.7, "drag": 0.6},
    "length": {"slack": 1e-3, "expansion": 1e-4, "creep_share": 0.3, "creep_time": 0.05},
    "dashpots": {"viscosity": 300.0, "drag": 0.2, "asymmetry": 1.3},
    "bristles": {"presliding": 5e-5, "drag": 0.3},
    "short bristles": {"presliding": 1e-6, "presliding_tension": 30.0, "asymmetry": 1.2},
    "all": {
        "friction_scale": 0.8,
        "viscosity": 3000.0,
        "presliding": 2e-4,
        "presliding_tension": 3.0,
        "drag": 1.0,
        "slack": 1e-3,
        "creep_share": 0.5,
        "creep_time": 0.01,
    },
}


def random_chain(rng, **deviations):
    nodes = int(rng.choice([1, 2, 20, 60]))
    cell = rng.uniform(0.5, 2.0, nodes)
    cell *= L / cell.sum()
    friction = rng.uniform(0.0, 1.0, nodes) * (rng.random(nodes) < 0.8)
    friction *= rng.choice([0.0, 0.1, 1.0, 3.0]) / max(0.1, sum(friction))
    compliance = np.concatenate([cell / 2, [0]]) + np.concatenate([[0], cell / 2])
    compliance /= rng.choice([1e3, 9e3, 5e4])
    pretension = float(rng.choice([0, 1, 5]))
    friction, whole = np.minimum(1.0, friction), np.zeros(nodes + 1)
    return Chain(compliance, friction, cell, pretension, TendonDeviations(**deviations), whole)


def random_path(rng, steps):
    """Return places of a motor that creeps, jumps, and lets the tendon go slack."""
    path, motor = [], 0.0
    for _ in range(steps):
        kind = rng.integers(4)
        if kind == 0:
            motor += rng.normal() * 1e-5
        elif kind == 1:
            motor += rng.normal() * 1e-3
        elif kind == 2:
            motor = rng.uniform(-3e-3, 15e-3)
        path.append(motor)
    return np.array(path)


def assert_balanced(chain, before, after, dt):
    """Require of a step what friction, bristles, dashpots and springs each demand."""
    deviations = chain.deviations
    T, u = after[TENSION, :-1], after[POSITION]
    scale = 1e-10 * max(1.0, T.max())
    gain = 1.0 - np.exp(-dt / deviations.creep_time)
    crept = deviations.creep_share * (T - chain.pretension)
    crept = before[CREEP, :-1] + gain * (crept - before[CREEP, :-1])
    assert after[CREEP, :-1] == pytest.approx(crept, abs=scale)
    stiffness = chain.cell.sum() / chain.compliance.sum()
    too_long = deviations.slack * stiffness / chain.cell.sum() + deviations.expansion * stiffness
    stretched = (u[:-1] - u[1:] - chain.parted) / chain.compliance
    pulled = chain.pretension + stretched - crept - too_long
    assert pytest.approx(np.maximum(0.0, pulled), abs=scale) == T
    assert T.min() >= 0.0

    moved = after[POSITION, 1:-1] - before[POSITION, 1:-1]
    dry = T[:-1] - T[1:] - deviations.viscosity * chain.cell * moved / dt
    assert after[FRICTION, 1:-1] == pytest.approx(dry, abs=scale)
    pressed = T[:-1] - dry / 2 + deviations.drag
    most = chain.friction * deviations.friction_scale * pressed
    least = -deviations.asymmetry * most
    assert np.all(dry <= most + scale)
    assert np.all(dry >= least - scale)
    within = (dry < most - 2 * scale) & (dry > least + 2 * scale)
    sliding = chain.friction > 0.0
    if deviations.presliding > 0.0 or deviations.viscosity > 0.0:
        bristle = np.full(len(moved), RIGID_STIFFNESS)
        if deviations.presliding > 0.0:
            bristle = chain.friction * deviations.presliding_tension / deviations.presliding
        leaning, scale = before[FRICTION, 1:-1] + bristle * moved, scale + 1e-17 * bristle.max()
        assert dry[within & sliding] == pytest.approx(leaning[within & sliding], abs=scale)
        in_, out = leaning > most + 2 * scale, leaning < least - 2 * scale
    else:
        assert np.abs(moved[within & sliding]).max(initial=0.0) < 1e-14
        in_, out = moved > 1e-14, moved < -1e-14
    assert dry[in_] == pytest.approx(most[in_], abs=scale)
    assert dry[out] == pytest.approx(least[out], abs=scale)


@pytest.mark.parametrize("deviations", EXACT.values(), ids=EXACT.keys())
@pytest.mark.parametrize("seed", range(2))
def test_every_step_obeys_every_law_at_each_node_and_balances_the_load(seed, deviations):
    rng = np.random.default_rng(seed)
    chain = random_chain(rng, **deviations)
    dt = float(rng.choice([1e-5, 1e-3, 1e-2]))
    stiffness = float(rng.choice([1.0, 200.0, 1e6]))
    states = [init_chain_state(chain)]
    for motor in np.split(random_path(rng, 240), 8):
        load = Load(float(rng.uniform(0.0, 10.0)), stiffness)
        states += list(drive(chain, load, motor, states[-1], dt)[1:])
        assert proximal(states[-1]) == motor[-1]
        pull = load.force + load.stiffness * distal(states[-1])
        T_out = get_tensions(chain, states[-1])[-1]
        assert pytest.approx(max(0.0, pull), abs=1e-8 * max(1.0, T_out)) == T_out
    for before, after in pairwise(states):
        assert_balanced(chain, before, after, dt)


@pytest.mark.parametrize("deviations", EXACT.values(), ids=EXACT.keys())
def test_the_tension_never_rises_as_the_tip_comes(deviations):
    rng = np.random.default_rng(3)
    chain = random_chain(rng, **deviations)
    state = drive(chain, SPRING, random_path(rng, 30))[-1]
    response = compute_response(chain, state, 4e-3, 1e-3)
    places = np.sort(np.concatenate([response.tip.place, rng.uniform(-1e-2, 1e-2, 300)]))
    T = np.array([interpolate_curve(response.tip, place) for place in places])
    assert np.all(np.diff(T) <= 1e-9)
    assert np.all(T >= 0.0)
    assert T[-1] == 0.0
    assert T[0] > 10.0


def test_bristles_may_need_more_corners_than_there_is_room_for_at_first():
    """Soft contacts of many small cells lean, slide and lean again along one response."""
    rng = np.random.default_rng(45)
    chain = uniform(2.0, 200, presliding=1e-3, drag=2.0)
    most, state = 0, init_chain_state(chain)
    for motor in random_path(rng, 40):
        response = compute_response(chain, state, motor, 1e-3)
        most = max(most, response.inner.corners.max())
        assert np.all(np.diff(response.tip.place) < 1e-12)
        assert np.all(np.diff(response.tip.tension) > -1e-6)
        before, state = state, drive(chain, SPRING, [motor], state)[-1]
        assert_balanced(chain, before, state, 1e-3)
    assert most > 2 * 200 + 8


@pytest.mark.parametrize(
    ("deviations", "nodes", "steps"),
    [
        ({"friction_scale": 50.0, "asymmetry": 3.0, "drag": 1.0}, 300, 60),
        ({"viscosity": 5000.0}, 1000, 6),
        ({"presliding": 1e-6, "presliding_tension": 100.0, "drag": 10.0}, 300, 60),
    ],
    ids=["friction", "dashpots", "bristles"],
)
def test_what_nothing_passes_stays_finite(deviations, nodes, steps):
    chain = uniform(9.0, nodes, 1.0, axial_stiffness=900.0, **deviations)
    chain.friction[100:105] = 1e3
    path = random_path(np.random.default_rng(1), steps)
    states = drive(chain, SPRING, path, dt=1e-5)
    assert np.all(np.isfinite(states))
    assert states[:, TENSION].min() == 0.0
    assert ends(states)[1].max() < 2.0 + 500.0 * travels(states)[1].max()


def test_nested_reversals_against_a_solver_that_guesses_and_corrects():
    deviations = {"asymmetry": 0.75, "drag": 0.5}
    sections = (0.4, 0.3), (0.6, 0.15), (0.5, 1.0)
    sheath = SheathConfig(tuple(SectionConfig(*s) for s in sections), 0.2, EA, 60)
    chain = turned(build_chain(sheath, 4.0), **deviations)
    other = brute.Chain(sections, 0.2, EA, beads=60, tension=4.0, **deviations)
    turns = (0.0, 12e-3, 6e-3, 10e-3, 7e-3, 9e-3, 5e-3, 11e-3)
    path = np.concatenate([np.linspace(a, b, 80)[1:] for a, b in pairwise(turns)])
    states = drive(chain, Load(4.0, 400.0), path)[1:]
    for motor, state in zip(path, states, strict=True):
        other.move(brute.Position(motor), brute.Spring(400.0, -4.0 / 400.0))
        assert get_tensions(chain, state) == pytest.approx(other.tensions, abs=1e-8)


def test_the_error_of_coarse_cells_falls_with_their_square():
    path = np.concatenate([np.linspace(0, 3e-3, 40), np.linspace(3e-3, 1.5e-3, 40)])
    path = np.concatenate([path, np.linspace(1.5e-3, 2.5e-3, 40)])

    def seen(nodes):
        return np.array(ends(drive(uniform(1.0, nodes), BLOCKED, path)))

    fine = seen(640)
    errors = [np.abs(seen(n) - fine).max() for n in (10, 20, 40, 80)]
    # 4 a doubling if every front stopped on a node, which none does
    assert errors[0] / errors[3] > 4.0**3 / 2.0
    assert errors[2] < 2e-3 * fine.max()


def energies(chain, states):
    """Return what springs, creep and bristles store [J], each of shape (states, parts)."""
    deviations = chain.deviations
    T, y, f = states[:, TENSION, :-1], states[:, CREEP, :-1], states[:, FRICTION, 1:-1]
    spring = 0.5 * chain.compliance * T**2
    creep = 0.0 * y
    if deviations.creep_share > 0.0:
        creep = chain.compliance * (0.5 * y**2 / deviations.creep_share + chain.pretension * y)
    bristle = 0.0 * f
    if deviations.presliding > 0.0:
        stiffness = chain.friction * deviations.presliding_tension / deviations.presliding
        bristle = 0.5 * f**2 / np.where(stiffness > 0.0, stiffness, np.inf)
    elif deviations.viscosity > 0.0:
        bristle = 0.5 * f**2 / RIGID_STIFFNESS
    return spring, creep, bristle


PASSIVE = st.fixed_dictionaries(
    {
        "friction_scale": st.floats(0.0, 2.0),
        "asymmetry": st.floats(0.3, 2.0),
        "drag": st.sampled_from([0.0, 0.5, 3.0]),
        "viscosity": st.sampled_from([0.0, 10.0, 3000.0]),
        "presliding": st.sampled_from([0.0, 1e-6, 5e-5, 1e-3]),
        "stribeck_ratio": st.sampled_from([0.0, 0.5]),
        "stribeck_memory": st.sampled_from([1e-3, 0.2]),
        "static_ratio": st.sampled_from([1.0, 1.5]),
        "tension_exponent": st.sampled_from([0.7, 1.0]),
        "compression_friction": st.sampled_from([0.0, 0.005]),
        "creep_share": st.sampled_from([0.0, 0.5]),
        "creep_time": st.sampled_from([1e-3, 1.0]),
        "slack": st.sampled_from([0.0, 5e-4]),
    }
)


@settings(max_examples=60, deadline=None)
@given(deviations=PASSIVE, seed=st.integers(0, 2**20), dt=st.sampled_from([1e-5, 1e-3, 1e-2]))
def test_a_tendon_never_gives_more_work_than_it_was_given(deviations, seed, dt):
    rng = np.random.default_rng(seed)
    chain = random_chain(rng, **deviations)
    tip = rng.uniform(-0.3, 0.3) * random_path(rng, 150)
    states = stretch(chain, 0.3 * random_path(rng, 150), tip, dt=dt)
    T, u = states[1:, TENSION, :-1], states[:, POSITION]
    moved = np.diff(u, axis=0)
    spring, creep, bristle = (np.diff(part, axis=0) for part in energies(chain, states))
    scale = 1e-10 * max(1.0, T.max()) * (np.abs(moved).max() + 1e-6)

    friction = states[1:, FRICTION, 1:-1] * moved[:, 1:-1]
    assert np.min(friction - bristle) > -scale
    dashpots = deviations["viscosity"] * chain.cell * moved[:, 1:-1] ** 2 / dt
    springs = T * (moved[:, :-1] - moved[:, 1:])
    given_ = T[:, 0] * moved[:, 0] - T[:, -1] * moved[:, -1]
    kept = np.sum(spring + creep, axis=1) + np.sum(bristle, axis=1)
    lost = np.sum(friction - bristle + dashpots, axis=1)
    assert given_ == pytest.approx(
        np.sum(springs, axis=1) + np.sum(friction + dashpots, axis=1), abs=100 * scale
    )
    if deviations["slack"] == 0.0:  # slack that appears lets springs go without work
        assert np.min(springs - spring - creep) > -scale
        assert np.min(given_ - kept - lost) > -100 * scale


def test_a_slack_tendon_pushes_nothing_and_takes_up_what_was_paid_out():
    chain = uniform(1.0, pretension=1.0)
    load = Load(1.0, 200.0)
    states = drive(chain, load, np.linspace(0, -12e-3, 100))
    T = get_tensions(chain, states[-1])
    assert np.all(T[0] == 0.0)
    assert T.max() < 1e-12
    assert distal(states[-1]) == pytest.approx(-1.0 / 200.0, abs=1e-12)  # where the spring rests
    again = drive(chain, load, np.linspace(-12e-3, 0, 500), states[-1])
    taut = travels(again)[0][np.flatnonzero(ends(again)[0] > 0.0)[0]]
    # the tip rests 5 mm out, and a tendon without its pretension is 1 N * L/EA shorter stretched
    assert taut == pytest.approx(-5e-3 - L / EA, abs=4e-5)


@pytest.mark.parametrize("deviations", EXACT.values(), ids=EXACT.keys())
def test_both_ends_of_a_broken_tendon_may_be_pulled(deviations):
    rng = np.random.default_rng(2)
    for _ in range(40):
        chain = random_chain(rng, **{"drag": 0.6} | deviations)
        chain.parted[rng.integers(len(chain.parted))] = 0.05
        loose = stretch(chain, [0.0], [0.0])[-1]
        apart = stretch(chain, [rng.uniform(0.0, 8e-3)], [rng.uniform(-8e-3, 0.0)], loose)[-1]
        assert_balanced(chain, loose, apart, 1e-3)
        assert get_tensions(chain, apart).min() == 0.0
