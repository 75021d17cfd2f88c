"""The chain against the laws it is made of, and against limits that need no theory of sheaths."""

import numpy as np
import pytest

from slave.plant.chain import (
    Chain,
    SectionConfig,
    SheathConfig,
    build_chain,
    settle,
    tensions,
)
from slave.plant.load import ContactConfig, Load, TipConfig, build_load, load_force

L, EA = 1.5, 9000.0
SPRING = Load(0.0, 500.0, np.empty(0), np.empty(0))
BLOCKED = Load(0.0, 1e7, np.empty(0), np.empty(0))


def uniform(K, nodes=60, pretension=0.0, axial_stiffness=EA):
    sheath = SheathConfig((SectionConfig(L, 0.2),), K * 0.2 / L, axial_stiffness, nodes)
    return build_chain(sheath, pretension)


def drive(chain, load, path, state=None):
    """Move the motor along `path`; return all states, the first being the one before it."""
    states = [np.zeros(len(chain.friction) + 2) if state is None else state]
    for motor in path:
        states.append(settle(chain, load, states[-1], motor))
    return np.array(states)


def random_case(rng):
    nodes = int(rng.choice([1, 2, 20, 60]))
    cell = rng.uniform(0.5, 2.0, nodes)
    cell *= L / cell.sum()
    friction = rng.uniform(0.0, 1.0, nodes) * (rng.random(nodes) < 0.8)
    friction = np.minimum(
        1.0, friction * rng.choice([0.0, 0.1, 1.0, 3.0]) / max(0.1, sum(friction))
    )
    compliance = np.concatenate([cell / 2, [0]]) + np.concatenate([[0], cell / 2])
    chain = Chain(compliance / rng.choice([1e3, 9e3, 5e4]), friction, float(rng.choice([0, 1, 5])))
    spring = float(rng.choice([1.0, 200.0, 1e6]))
    contacts = np.array([3e-3, 8e-3]), np.array([1500.0, rng.choice([0.0, 1e5])])
    return chain, lambda pretension: Load(pretension, spring, *contacts)


@pytest.mark.parametrize("seed", range(12))
def test_every_state_obeys_coulomb_at_each_node_and_balances_the_load(seed):
    rng = np.random.default_rng(seed)
    chain, load_with = random_case(rng)
    load = load_with(chain.pretension)
    state, motor = np.zeros(len(chain.friction) + 2), 0.0
    for _ in range(400):
        kind = rng.integers(4)
        if kind == 0:
            motor += rng.normal() * 1e-5
        elif kind == 1:
            motor += rng.normal() * 1e-3
        elif kind == 2:
            motor = rng.uniform(-3e-3, 15e-3)
        if rng.random() < 0.3:
            load = load_with(rng.uniform(0.0, 10.0))
        after = settle(chain, load, state, motor)
        T = chain.pretension + (after[:-1] - after[1:]) / chain.compliance
        T = np.maximum(T, 0.0)
        force = T[:-1] - T[1:]
        limit = chain.friction * (T[:-1] + T[1:]) / 2
        moved = after[1:-1] - state[1:-1]
        scale = 1e-10 * max(1.0, T.max())
        assert after[0] == motor
        assert np.all(np.abs(force) <= limit + scale)
        assert force[moved > 1e-14] == pytest.approx(limit[moved > 1e-14], abs=scale)
        assert force[moved < -1e-14] == pytest.approx(-limit[moved < -1e-14], abs=scale)
        pull = load.pretension + load.spring * after[-1]
        pull += np.sum(load.contact_stiffness * np.maximum(0.0, after[-1] - load.contact_travel))
        assert T[-1] == pytest.approx(pull, abs=max(scale, 1e-12 * load.spring))
        state = after


def test_without_friction_the_tension_arrives_and_the_tendon_is_one_spring():
    chain = uniform(0.0)
    for motor in (1e-3, 4e-3, 2e-3):
        state = drive(chain, SPRING, [motor])[-1]
        T = tensions(chain, state)
        assert pytest.approx(T[0], rel=1e-10) == T[-1]
        assert motor - state[-1] == pytest.approx(T[-1] * L / EA, rel=1e-9)


def test_a_rigid_tendon_moves_its_tip_by_what_the_motor_moves():
    chain = uniform(1.0, axial_stiffness=1e7)
    path = np.linspace(0.0, 0.01, 50)
    tip = drive(chain, SPRING, path)[1:, -1]
    assert tip == pytest.approx(path, abs=1e-5)


def capstan(K, steps):
    """Tension ratio and mean tension of a full pull, one small friction loss after another."""
    tension, total = 1.0, 0.0
    for _ in range(steps):
        total += tension / steps
        tension -= tension * K / steps
    return tension, total - 0.5 * (1.0 - tension) / steps


@pytest.mark.parametrize("K", [0.3, 1.0, 2.5])
def test_a_full_pull_loses_what_summing_small_losses_gives(K):
    ratio, mean = capstan(K, 400_000)
    chain = uniform(K, nodes=120)
    state = drive(chain, BLOCKED, np.linspace(0.0, 3e-3, 30))[-1]
    T = tensions(chain, state)
    assert T[-1] / T[0] == pytest.approx(ratio, rel=2e-4)
    assert (state[0] - state[-1]) / T[0] == pytest.approx(mean * L / EA, rel=2e-4)


def test_a_full_release_gains_what_a_pull_loses():
    chain = uniform(1.0)
    path = np.concatenate([np.linspace(0, 3e-3, 30), np.linspace(3e-3, 5e-4, 60)])
    states = drive(chain, BLOCKED, path)
    pulled, released = (tensions(chain, states[i]) for i in (30, -1))
    assert released[-1] / released[0] == pytest.approx(pulled[0] / pulled[-1], rel=1e-9)


def test_the_error_of_coarse_cells_falls_with_their_square():
    path = np.concatenate([np.linspace(0, 3e-3, 40), np.linspace(3e-3, 1.5e-3, 40)])
    path = np.concatenate([path, np.linspace(1.5e-3, 2.5e-3, 40)])

    def ends(nodes):
        chain = uniform(1.0, nodes)
        return np.array([tensions(chain, s)[[0, -1]] for s in drive(chain, BLOCKED, path)])

    fine = ends(320)
    coarse, half = (np.abs(ends(n) - fine).max() for n in (10, 40))
    assert coarse / half > 8.0  # 16 if every front stopped on a node, which none does
    assert half < 2e-3 * fine.max()


def test_the_parts_of_a_sheath_add_up_to_the_whole():
    sections = SectionConfig(0.3), SectionConfig(0.8, 0.25), SectionConfig(0.4, 0.1)
    chain = build_chain(SheathConfig(sections, 0.15, EA, 50), 1.0)
    assert chain.compliance.sum() == pytest.approx(L / EA)
    assert chain.friction.sum() == pytest.approx(0.15 * (0.8 / 0.25 + 0.4 / 0.1))
    assert chain.friction[0] == 0.0
    assert len(chain.compliance) == len(chain.friction) + 1


def test_after_a_reversal_the_tip_stays_until_the_change_arrives():
    chain = uniform(1.0)
    pulled = drive(chain, SPRING, np.linspace(0, 6e-3, 60))[-1]
    back = drive(chain, SPRING, np.linspace(6e-3, 3e-3, 300), pulled)
    tip = back[:, -1]
    T_in = np.array([tensions(chain, state)[0] for state in back])
    still = np.abs(tip - pulled[-1]) < 1e-15
    assert 20 < still.sum() < 280
    assert np.all(np.diff(still.astype(int)) <= 0)  # once it moves it goes on moving
    last = np.flatnonzero(still)[-1]
    ratio, _ = capstan(1.0, 400_000)
    assert T_in[last + 1] / T_in[0] == pytest.approx(ratio**2, rel=0.05)


def test_one_large_step_ends_where_many_small_ones_do():
    chain = uniform(1.3, pretension=1.0)
    load = build_load(TipConfig())
    far = drive(chain, load, [8e-3])[-1]
    near = drive(chain, load, np.linspace(0, 8e-3, 500))[-1]
    assert far == pytest.approx(near, abs=1e-12)


def test_friction_never_gives_work_and_takes_what_the_loop_encloses():
    chain = uniform(1.0, pretension=1.0)
    load = build_load(TipConfig())
    wave = 4e-3 * (1.0 - np.cos(np.linspace(0, 4 * np.pi, 4001)))
    states = drive(chain, load, wave)[1:]
    T = np.array([tensions(chain, state) for state in states])
    force = T[1:, :-1] - T[1:, 1:]
    lost = (force * np.diff(states[:, 1:-1], axis=0)).sum(axis=1)
    assert lost.min() >= -1e-15
    second = slice(2000, 4001)  # the first turn starts from rest, the second is a closed loop
    work = np.trapezoid(T[second, 0], states[second, 0])
    assert states[-1] == pytest.approx(states[2000], abs=1e-12)
    assert work == pytest.approx(lost[2000:].sum(), rel=2e-3)
    assert work > 0.0


def test_a_slack_tendon_pushes_nothing_and_takes_up_what_was_paid_out():
    chain = uniform(1.0, pretension=1.0)
    load = build_load(TipConfig(pretension=1.0, spring=200.0))
    states = drive(chain, load, np.linspace(0, -12e-3, 100))
    T = tensions(chain, states[-1])
    assert np.all(T[0] == 0.0)
    assert T.max() < 1e-12
    assert states[-1, -1] == pytest.approx(-1.0 / 200.0, abs=1e-12)  # where the spring rests
    again = drive(chain, load, np.linspace(-12e-3, 0, 500), states[-1])
    T_in = np.array([tensions(chain, state)[0] for state in again])
    taut = again[np.flatnonzero(T_in > 0.0)[0], 0]
    # the tip rests 5 mm out, and a tendon without its pretension is 1 N * L/EA shorter stretched
    assert taut == pytest.approx(-5e-3 - L / EA, abs=4e-5)


def test_a_load_that_falls_is_seen_at_the_housing_and_one_that_rises_is_not():
    chain = uniform(1.0)
    load = Load(2.0, 500.0, np.empty(0), np.empty(0))
    pulled = drive(chain, load, np.linspace(0, 8e-3, 80))[-1]
    T_in, T_out = tensions(chain, pulled)[[0, -1]]
    less = settle(chain, load._replace(pretension=1.5), pulled, pulled[0])
    more = settle(chain, load._replace(pretension=4.0), pulled, pulled[0])
    assert tensions(chain, less)[0] < T_in - 0.1
    assert tensions(chain, more)[0] == pytest.approx(T_in, abs=1e-9)
    assert tensions(chain, more)[-1] > T_out + 0.1


def test_the_load_is_what_its_config_says():
    load = build_load(TipConfig(1.0, 200.0, (ContactConfig(0.008, 1000.0),)))
    assert load_force(load, 0.008) == pytest.approx((2.6, 200.0))
    assert load_force(load, 0.010) == pytest.approx((5.0, 1200.0))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SheathConfig(friction=2.0, nodes=10), "nodes: must be about"),
        (lambda: SheathConfig(sections=()), "sections"),
        (lambda: SectionConfig(1.0, float("nan")), "radius"),
        (lambda: SectionConfig(-1.0), "length"),
        (lambda: TipConfig(spring=0.0), "spring"),
        (lambda: TipConfig(pretension=float("nan")), "pretension"),
        (lambda: ContactConfig(-0.001), "travel"),
    ],
)
def test_a_plant_that_cannot_be_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_the_number_of_nodes_asked_for_is_enough():
    with pytest.raises(ValueError, match="about") as caught:
        SheathConfig(friction=2.0, nodes=10)
    needed = int(str(caught.value).split("about ")[1].split(" ")[0])
    SheathConfig(friction=2.0, nodes=needed)
