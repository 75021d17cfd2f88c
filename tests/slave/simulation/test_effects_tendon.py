"""Each effect of a tendon against the signature that its cause has, and against its own limits."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from slave.simulation.effects import compute_deviations
from slave.simulation.effects.elasticity import (
    Creep,
    NonlinearStiffness,
    SheathCompression,
    Slack,
    ThermalExpansion,
)
from slave.simulation.effects.friction import (
    ConstantDrag,
    DirectionAsymmetry,
    FrictionDrift,
    FrictionStep,
    Presliding,
    StickSlip,
    StribeckFriction,
    TensionDependentFriction,
    ViscousFriction,
)
from slave.simulation.tendon import POSITION, TENSION, get_tensions
from tests.slave.tendon_bench import (
    EA,
    L,
    Load,
    drive,
    ends,
    proximal,
    stretch,
    travels,
    uniform,
)

K = 1.0


def under(chain, *effects, time=1e9, slid=0.0):
    """Return the chain under effects that began `time` [s] and `slid` [m] ago."""
    return chain._replace(deviations=compute_deviations(effects, time, [slid] * len(effects)))


def pull(chain, to=3e-3, tip=0.0, steps=300, dt=1e-3):
    """Pull the housing end from rest, the tip being held; return all states."""
    return stretch(chain, np.linspace(0.0, to, steps), tip, dt=dt)


def swing(chain, low=3e-4, high=3e-3, steps=400, dt=1e-3):
    """Pull from rest and let go, the tip being held; return the states of both ways."""
    path = np.concatenate([np.linspace(0.0, high, steps), np.linspace(high, low, steps)[1:]])
    states = stretch(chain, path, 0.0, dt=dt)[1:]
    return states[:steps], states[steps:]


def profile(T_in, loss, nodes=2000):
    """Return x [m] and T [N] along a sheath with dT/dx = -loss(x, T) from the housing on."""
    x = np.linspace(0.0, L, nodes)
    found = solve_ivp(lambda s, T: -loss(s, T), (0.0, L), [T_in], t_eval=x, rtol=1e-9, atol=1e-12)
    return x, found.y[0]


def at_tip(T_in, loss):
    """Return the tension at the tip of a fully sliding tendon, for each at the housing."""
    return np.array([profile(T, loss)[1][-1] for T in np.atleast_1d(T_in)])


def mobilised(states):
    """Return T_in and T_out where the tip has long begun to follow, a few samples apart."""
    return ends(states[len(states) * 7 // 8 :: 10])


def test_a_sheath_that_bends_less_lets_go_at_once_and_one_that_bends_more_when_it_moves():
    chain = uniform(1.1, 120)
    states = pull(chain, 3e-3)
    state = stretch(chain, np.linspace(3e-3, 2.9e-3, 100), 0.0, states[-1])[-1]
    state = stretch(chain, np.linspace(2.9e-3, 3.1e-3, 200), 0.0, state)[-1]
    less, more = under(chain, FrictionStep(change=-0.25)), under(chain, FrictionStep(change=0.25))

    relaxed = stretch(less, [proximal(state)], 0.0, state)[-1]
    ratio = np.exp(0.825) * (1 - np.exp(-1.1)) / 1.1 * 0.825 / (1 - np.exp(-0.825))
    (T_in, T_out), (T_in_, T_out_) = (get_tensions(chain, s)[[0, -1]] for s in (state, relaxed))
    assert T_in_ < 0.92 * T_in
    assert T_out_ > 1.15 * T_out
    assert T_in_ / T_out_ == pytest.approx(np.exp(0.825), rel=1e-3)
    assert T_out_ / T_in * np.exp(0.825) == pytest.approx(ratio / np.exp(0.825), rel=2e-3)

    stays = stretch(more, [proximal(state)] * 5, 0.0, state)[-1]
    assert stays[TENSION] == pytest.approx(state[TENSION], abs=1e-12)
    moves = stretch(more, np.linspace(3.1e-3, 4e-3, 200), 0.0, stays)[-1]
    T_in, T_out = get_tensions(chain, moves)[[0, -1]]
    assert T_in / T_out == pytest.approx(np.exp(1.375), rel=1e-3)


def test_friction_drifts_with_time_or_with_the_way_slid_and_stops_at_its_limit():
    chain = uniform(K, 120)
    for effect, time, slid, change in (
        (FrictionDrift(per_second=-0.01), 20.0, 5.0, -0.2),
        (FrictionDrift(per_metre=0.1), 20.0, 3.0, 0.3),
        (FrictionDrift(per_second=0.01, per_metre=0.1), 10.0, 2.0, 0.3),
        (FrictionDrift(per_second=0.1, limit=0.4), 60.0, 0.0, 0.4),
        (FrictionDrift(per_second=-0.1, limit=5.0), 60.0, 0.0, -1.0),
    ):
        T_in, T_out = mobilised(pull(under(chain, effect, time=time, slid=slid)))
        assert np.log(T_in / T_out) == pytest.approx(K * (1.0 + change), rel=1e-3, abs=1e-9)


def test_a_constant_drag_takes_the_same_from_every_tension():
    pulled, released = swing(under(uniform(K, 120), ConstantDrag(drag=0.6)))
    T_in, T_out = mobilised(pulled)
    assert T_out - T_in * np.exp(-K) == pytest.approx(-0.6 * (1 - np.exp(-K)), rel=1e-3)
    T_in, T_out = mobilised(released)
    assert T_out - T_in * np.exp(K) == pytest.approx(0.6 * (np.exp(K) - 1), rel=2e-3)


def test_asymmetry_changes_a_release_and_no_pull():
    pulled, released = swing(under(uniform(K, 120), DirectionAsymmetry(ratio=0.7)))
    T_in, T_out = mobilised(pulled)
    assert np.log(T_in / T_out) == pytest.approx(K, rel=1e-3)
    T_in, T_out = mobilised(released)
    assert np.log(T_out / T_in) == pytest.approx(0.7 * K, rel=1e-3)


def test_viscous_friction_grows_with_speed_and_ends_with_motion():
    effect = ViscousFriction(viscosity=40.0)
    straight, bent = (under(uniform(k, 120), effect) for k in (0.0, K))
    weight = Load(8.0, 1e-3)
    for v in (10e-3, 50e-3):
        path = v * np.arange(0.0, 0.02 / v, 1e-3)
        T_in, T_out = ends(drive(straight, weight, path))
        assert T_in[-1] - T_out[-1] == pytest.approx(40.0 * L * v, rel=1e-3)
        states = drive(bent, weight, path)
        T_in, T_out = ends(states)
        expected = at_tip(T_in[-1], lambda _, T, v=v: K / L * T + 40.0 * v)
        assert T_out[-1] == pytest.approx(expected, rel=1e-3)
    held = drive(bent, weight, [path[-1]] * 3000, states[-1])
    T_in, T_out = ends(held)
    assert T_in[-1] / T_out[-1] < np.exp(K) * 1.001  # what is left is what dry friction holds
    assert np.abs(np.diff(held[-2:, POSITION], axis=0)).max() < 1e-12
    T_in, T_out = ends(drive(straight, weight, [path[-1]] * 3000, states[-1]))
    assert T_in[-1] == pytest.approx(T_out[-1], rel=1e-6)


def test_stribeck_friction_is_that_of_the_speed_and_overshoots_at_the_start():
    effect = StribeckFriction(ratio=0.25, speed=1e-3)
    chain, weight = under(uniform(K), effect), Load(5.0, 1.0)
    start = drive(chain, weight, [5e-3] * 3000)[-1]
    for v in (2e-4, 1e-3, 3e-3):
        path = 5e-3 + v * np.arange(0.0, 3.0, 1e-3)
        T_in, T_out = ends(drive(chain, weight, path, start))
        expected = K * (1.0 + 0.25 * np.exp(-((v / 1e-3) ** 2)))
        assert np.log(T_in / T_out)[-100:] == pytest.approx(expected, rel=2e-3)
    steady = T_in[-1]
    assert T_in.max() > 1.1 * steady  # of the fastest: friction was still that of rest


def test_stick_slip_is_a_saw_tooth_at_low_speed_and_nothing_at_a_high_one():
    effect = StickSlip(ratio=1.3, rest_time=0.5, distance=2e-5)
    chain, soft = uniform(K), Load(5.0, 50.0)
    start = drive(chain, soft, np.linspace(0.0, 5e-3, 500))[-1]

    def teeth(v, dt=1e-3):
        path = 5e-3 + v * np.arange(0.0, 15.0, dt)
        T_in, T_out = ends(drive(under(chain, effect), soft, path, start, dt))
        late = slice(len(path) // 3, None)
        drops = np.flatnonzero(np.diff(T_in[late]) < -0.05)
        jerks = np.count_nonzero(np.diff(drops, prepend=-1000) > 20)
        return jerks, np.ptp(np.log(T_in / T_out)[late])

    jerks, height = teeth(1e-4)
    assert 5 < jerks < 100
    assert 0.1 < height < 0.3 * K * 1.001
    assert teeth(1e-4, 5e-4) == (pytest.approx(jerks, abs=2), pytest.approx(height, rel=0.1))
    assert teeth(1e-2) == (0, pytest.approx(0.0, abs=2e-3))


def test_tension_dependent_friction_bends_the_line_of_pull_and_of_release():
    effect = TensionDependentFriction(exponent=0.8, reference=10.0)
    pulled, released = swing(under(uniform(K, 120), effect), steps=2000)
    for states, sign in ((pulled, 1.0), (released, -1.0)):
        T_in, T_out = mobilised(states)
        expected = at_tip(T_in, lambda _, T, s=sign: s * K / L * T * (T / 10.0) ** -0.2)
        assert T_out == pytest.approx(expected, rel=2e-3)
        assert np.ptp(np.log(T_out / T_in)) > 0.02


def strain(T, toe=0.0, T_s=2.0, compression=0.0, threshold=0.0):
    """Return the strain of tendon and sheath at tension T [N]."""
    bedded = T / EA + toe * (1.0 - np.exp(-T / T_s))
    return bedded + compression / L * np.maximum(0.0, T - threshold) ** 2


@pytest.mark.parametrize(
    ("effect", "law"),
    [
        (NonlinearStiffness(strain=1e-3, tension=2.0), {"toe": 1e-3}),
        (SheathCompression(compression=1e-6, threshold=5.0), {"compression": 1e-6, "threshold": 5}),
    ],
    ids=["toe", "compression"],
)
def test_more_give_means_more_travel_and_the_same_tension_at_the_tip(effect, law):
    chain = uniform(K, 120)
    states = pull(under(chain, effect), 6e-3, steps=2000)[600::100]
    (T_in, T_out), (motor, tip) = ends(states), travels(states)
    assert T_out / T_in == pytest.approx(np.exp(-K), rel=1e-3)
    for T, e in zip(T_in, motor - tip, strict=True):
        x, along = profile(T, lambda _, T: K / L * T)
        assert e == pytest.approx(np.trapezoid(strain(along, **law), x), rel=1e-3)


def test_slack_is_taken_up_before_anything_pulls():
    chain = uniform(K)
    (motor, _), (T, _) = travels(pull(chain)), ends(pull(chain))
    loose = pull(under(chain, Slack(length=1.5e-3)), 4.5e-3, steps=450)
    assert ends(loose)[0][:149].max() < 1e-9
    again = np.interp(travels(loose)[0], motor + 1.5e-3, T)
    assert ends(loose)[0] == pytest.approx(again, abs=0.02)
    tight = pull(uniform(K, pretension=5.0))[-1]
    gone = stretch(under(uniform(K, pretension=5.0), Slack(length=0.05)), [3e-3], 0.0, tight)[-1]
    assert gone[TENSION].max() == 0.0


def test_a_tendon_that_warms_up_needs_more_travel_for_the_same_tension():
    effect = ThermalExpansion(coefficient=1.2e-5, warming=20.0, time_constant=30.0)
    for time, share in ((0.0, 0.0), (30.0, 1.0 - np.exp(-1.0)), (1e4, 1.0)):
        for k in (0.0, K):
            warm = pull(under(uniform(k), effect, time=time), 4e-3)[-1:]
            cold = pull(uniform(k), 4e-3 - 1.2e-5 * 20.0 * share * L)[-1:]
            assert ends(warm) == (
                pytest.approx(ends(cold)[0], rel=1e-9),
                pytest.approx(ends(cold)[1], rel=1e-9),
            )


def test_a_tendon_creeps_at_a_held_position_as_a_standard_linear_solid_relaxes():
    a, tau = 0.1, 8.0
    chain = under(uniform(0.0), Creep(share=a, time_constant=tau))
    state = stretch(chain, [3e-3], 0.0, dt=1e-6)[-1]
    states = stretch(chain, [3e-3] * 2000, 0.0, state, dt=0.02)
    time = 0.02 * np.arange(2001)
    T_in, T_out = ends(states)
    relaxed = T_in[0] / (1 + a) * (1 + a * np.exp(-time * (1 + a) / tau))
    assert T_in == pytest.approx(relaxed, rel=2e-5)
    assert T_out == pytest.approx(T_in, rel=1e-9)
    back = stretch(chain, [0.0] * 2000, 0.0, states[-1], dt=0.02)
    assert ends(back)[0][1] == 0.0  # too long for a while
    assert ends(stretch(chain, [3e-3], 0.0, back[-1], dt=1e-6))[0][-1] > 0.99 * T_in[0]

    bent = under(uniform(K), Creep(share=a, time_constant=tau))
    pulled = pull(bent, dt=1e-5)[-1]
    T_in, T_out = ends(stretch(bent, [3e-3] * 500, 0.0, pulled, dt=0.1))
    assert T_in[-1] < 0.95 * T_in[0]
    assert T_out[-1] <= T_out[0]  # and it stays within what friction allows
    assert T_in[-1] / T_out[-1] < np.exp(K) * 1.001


LATE = {
    "toe": (NonlinearStiffness(strain=2e-3, tension=2.0), 2),
    "compression": (SheathCompression(compression=3e-6, threshold=1.0), 2),
    "grip": (SheathCompression(compression=3e-6, threshold=3.0, friction_rise=0.02), 1),
    "creep": (Creep(share=0.3, time_constant=0.1), 1),
    "tension": (TensionDependentFriction(exponent=0.7), 1),
    "Stribeck": (StribeckFriction(ratio=0.3, speed=5e-3, memory=0.1), 1),
    "stick-slip": (StickSlip(ratio=1.3, rest_time=0.05, distance=2e-4), 1),
    "viscous": (ViscousFriction(viscosity=60.0), 1),
}


@pytest.mark.parametrize(
    ("effect", "order"),
    [
        pytest.param(*late, id=name, marks=[] if name in ("toe", "creep") else pytest.mark.slow)
        for name, late in LATE.items()
    ],
)
def test_the_error_of_long_steps_falls_with_the_step(effect, order):
    chain = under(uniform(K, 20, pretension=1.0), effect)

    def seen(per_sample):
        time = np.linspace(0.0, 0.5, 50 * per_sample + 1)[1:]
        motor = 5e-3 * np.sin(np.pi * time) + 1e-3 * np.sin(4.0 * np.pi * time)
        states = drive(chain, Load(1.0, 3000.0), motor, dt=0.5 / len(time))
        return np.array(ends(states[::per_sample]))

    exact = seen(640)
    coarse, fine = (np.abs(seen(n) - exact).max() for n in (5, 40))
    assert fine < 2e-3 * exact.max()
    assert coarse / fine > 8.0**order / 2.0


@pytest.mark.parametrize(
    "effect",
    [
        FrictionStep(change=0.5),
        ViscousFriction(viscosity=500.0),
        Presliding(distance=2e-4),
        StickSlip(ratio=2.0),
        TensionDependentFriction(exponent=0.8, reference=100.0),
        Creep(),
    ],
    ids=lambda effect: effect.type,
)
def test_an_effect_that_begins_at_rest_moves_nothing_by_itself(effect):
    chain = uniform(K, pretension=1.0)
    pulled = drive(chain, Load(1.0, 500.0), np.linspace(0.0, 6e-3, 100))[-1]
    back = drive(chain, Load(1.0, 500.0), np.linspace(6e-3, 5.5e-3, 100), pulled)[-1]
    for state in (pulled, back):
        after = drive(under(chain, effect), Load(1.0, 500.0), [proximal(state)], state, 1e-6)[-1]
        assert after[TENSION] == pytest.approx(state[TENSION], abs=1e-5)
