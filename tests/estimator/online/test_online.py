import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from estimator.law.sheath import Section, Sheath
from estimator.law.transmission import Phase, build_slack_profile, build_tables, simulate_tensions
from estimator.online import online
from estimator.online.online import Status, TendonEstimate, TendonModel
from estimator.structs import view_struct
from studies.brute_force.chain import Chain, Force, Position
from tests.estimator.law.bounds import envelope
from tests.estimator.scenarios import HIDDEN, RATE, SCENARIOS, held, play, random_legs, spring

SHEATH = Sheath.uniform(1.0, 1.5, 9000.0)
SHEATHS = (
    SHEATH,
    Sheath.uniform(0.5, 1.2, 8000.0),
    Sheath((Section(0.3, 0.05), Section(0.9, 0.6), Section(0.3, 0.12)), 0.1, 9000.0),
)
NOISES = ((0.0, 0.0), (0.02, 1e-6), (0.05, 5e-6))
CHAIN_ERROR = 2e-3  # [N] of the 40 beads


@cache
def scenario(name):
    return play(SHEATH, SCENARIOS[name])


def measure(record, noise, seed=0):
    rng = np.random.default_rng(seed)
    n = len(record.time)
    return record.T_in + rng.normal(0.0, noise[0], n), record.q_p + rng.normal(0.0, noise[1], n)


def model(noise=(0.0, 0.0), sheath=SHEATH, **changes):
    return TendonModel(sheath, tension_noise=noise[0], displacement_noise=noise[1], **changes)


def estimate(record, noise=(0.0, 0.0), seed=0, **changes):
    T, q = measure(record, noise, seed)
    return online.run(online.prepare(model(noise, **changes)), record.time, T, q)


def outside(result, truth):
    return np.maximum(result.low - truth, truth - result.high).max()


@pytest.mark.parametrize("noise", NOISES[:2])
@pytest.mark.parametrize("name", SCENARIOS)
def test_estimate_follows_the_sliding_direction(name, noise):
    record = scenario(name)
    result = estimate(record, noise)
    peak = record.T_out.max()
    for leg in range(len(SCENARIOS[name])):
        if leg not in HIDDEN.get(name, ()):
            end = np.flatnonzero(record.leg == leg)[-1]
            error = result.distal_tension[end] - record.T_out[end]
            assert abs(error) < 0.05 * peak, f"leg {leg}: off by {error:.2f} N"


@pytest.mark.parametrize("stiffness_error", [0.96, 1.04])
@pytest.mark.parametrize("noise", NOISES[::2])
@pytest.mark.parametrize("name", SCENARIOS)
def test_truth_stays_inside_the_interval(name, noise, stiffness_error):
    record = scenario(name)
    accepted = replace(SHEATH, axial_stiffness=9000.0 * stiffness_error)
    assert outside(estimate(record, noise, sheath=accepted), record.T_out) < CHAIN_ERROR


@pytest.mark.parametrize("seed", [0, 1, 2, 5, 8, 14])
def test_truth_stays_inside_whatever_motor_and_tip_do(seed):
    rng = np.random.default_rng(seed)
    sheath = SHEATHS[seed % 3]
    record = play(sheath, random_legs(rng, tip_moves=seed % 2 == 1))
    assert record.T_in.min() > 0.0
    for noise in NOISES[:2]:
        result = estimate(record, noise, seed, sheath=sheath)
        assert outside(result, record.T_out) < CHAIN_ERROR
        assert (result.low <= result.distal_tension).all()
        assert (result.distal_tension <= result.high).all()


@pytest.mark.parametrize("noise", NOISES[1:])
def test_a_reversal_is_not_taken_for_full_sliding(noise):
    """Right after a turn T_in runs back within the noise while q_p has hardly turned."""
    seconds = (0.4, 0.46, 0.36, 0.34, 0.42, 0.42, 0.35, 0.49)
    travel = (1.865e-3, -0.17e-3, -0.104e-3, 0.127e-3, -0.245e-3, 0.127e-3, -0.422e-3, 0.427e-3)
    record = play(SHEATHS[2], [(t, q, held()) for t, q in zip(seconds, travel, strict=True)])
    for seed in range(8):
        result = estimate(record, noise, seed, sheath=SHEATHS[2])
        assert outside(result, record.T_out) < CHAIN_ERROR


def test_tension_rising_at_a_still_motor_is_the_tip_pulling():
    """(T18): the sign of dT_in/dt would say pull, and be wrong by e^2K."""
    record = scenario("tip is drawn out after a pull")
    result = estimate(record)
    rising = np.flatnonzero((np.gradient(record.T_in) > 0.01) & (record.leg == 2))
    seen = rising[record.T_in[rising] > record.T_in[rising[0]] + 0.5]
    assert result.distal_tension[seen] == pytest.approx(record.T_in[seen] * math.e, rel=0.02)
    assert (result.status[seen] & Status.TIP_MOVED).all()
    by_sign, _ = simulate_tensions(
        build_tables(SHEATH), build_slack_profile(build_tables(SHEATH)), record.T_in
    )
    assert record.T_out[seen] / by_sign[seen] == pytest.approx(math.e**2, rel=0.1)


@pytest.mark.parametrize("stiffness_error", [0.96, 1.04])
def test_a_blocked_tip_is_not_accused(stiffness_error):
    accepted = replace(SHEATH, axial_stiffness=9000.0 * stiffness_error)
    for seed in range(2):
        record = play(SHEATH, random_legs(np.random.default_rng(seed), tip_moves=False))
        result = estimate(record, NOISES[1], seed, sheath=accepted)
        assert not (result.status & Status.TIP_MOVED).any()


def test_step_and_run_give_the_same_numbers():
    record = scenario("nested reversals, then the tip is drawn out")
    T, q = measure(record, NOISES[1])
    T[50], q[90:100], T[200] = math.nan, math.nan, -9.0
    prepared = online.prepare(model(NOISES[1]))
    whole = online.run(prepared, record.time, T, q)
    state = online.build_initial_state(prepared)
    before = 0.0
    for i, t in enumerate(record.time):
        kept = state.tobytes()
        result, after = online.step(prepared, state, T[i], q[i], t - before if i else 0.0)
        assert state.tobytes() == kept, "step must leave the state it was given"
        for name, row in whole._asdict().items():
            assert np.array_equal(row[i], getattr(result, name), equal_nan=True), (i, name)
        state, before = after, t


def test_without_displacement_the_motor_is_taken_to_drive():
    record = scenario("spring at the tip")
    prepared = online.prepare(model())
    result = online.run(prepared, record.time, record.T_in)
    law, _ = simulate_tensions(
        build_tables(SHEATH), build_slack_profile(build_tables(SHEATH)), record.T_in
    )
    assert (result.status & Status.TENSION_ONLY).all()
    taut = record.T_in > 0.01
    assert result.distal_tension[taut] == pytest.approx(law[taut], rel=1e-9)
    assert np.isnan(result.distal_displacement).all()
    assert (result.high >= record.T_in * math.e).all()
    assert (result.low <= record.T_in / math.e).all()


def test_displacement_may_come_and_go():
    record = scenario("tip is drawn out after a pull")
    T, q = measure(record, NOISES[1])
    q[(record.leg == 0) & (record.time > 0.2)] = math.nan
    result = online.run(online.prepare(model(NOISES[1])), record.time, T, q)
    assert outside(result, record.T_out) < CHAIN_ERROR
    absent = np.isnan(q)
    assert ((result.status & Status.TENSION_ONLY != 0) == absent).all()
    assert result.distal_tension[-1] == pytest.approx(record.T_out[-1], rel=0.02)


def test_one_full_swing_erases_a_wrong_start():
    time = np.arange(2000) / RATE
    T = np.interp(time, [0, 1, 2, 3, 4], [6.0, 5.0, 14.0, 1.5, 12.0])
    right = online.run(online.prepare(model(initial=6.0)), time, T)
    wrong = online.run(online.prepare(model(initial=15.0)), time, T)
    unknown = wrong.status & Status.UNINITIALISED != 0
    assert unknown[0]
    assert not unknown[-1]
    erased = int(np.argmin(unknown))
    assert T[:erased].max() >= math.exp(2.0) * T[erased] * 0.99
    assert wrong.distal_tension[erased:] == pytest.approx(right.distal_tension[erased:], rel=1e-9)
    assert np.abs(wrong.distal_tension - right.distal_tension)[: int(RATE)].max() > 1.0


BAD = [
    (math.nan, 1e-3, 0.002),
    (math.inf, 1e-3, 0.002),
    (-5.0, 1e-3, 0.002),
    (8.0, math.inf, 0.002),
    (8.0, 1e-3, -0.002),
    (8.0, 1e-3, math.nan),
]


@pytest.mark.parametrize("sample", BAD)
def test_a_bad_sample_is_refused_held_and_widens_the_interval(sample):
    prepared = online.prepare(model())
    state = online.build_initial_state(prepared)
    for T in np.linspace(0.0, 8.0, 200):
        good, state = online.step(prepared, state, T, T * 1.0536e-4, 0.002)
    assert good.status == Status.OK
    previous = good
    for _ in range(3):
        held_estimate, state = online.step(prepared, state, *sample)
        assert held_estimate.status & Status.INVALID_INPUT
        assert held_estimate.distal_tension == good.distal_tension
        fields = ("distal_tension", "low", "high", "elongation")
        assert all(math.isfinite(getattr(held_estimate, name)) for name in fields)
        assert held_estimate.low <= previous.low
        assert held_estimate.high >= previous.high
        previous = held_estimate
    if sample[2] > 0.0:
        assert held_estimate.high > good.high
    again, _ = online.step(prepared, state, 8.0, 8.0 * 1.0536e-4, 0.002)
    assert not again.status & Status.INVALID_INPUT
    assert again.distal_tension == pytest.approx(good.distal_tension, rel=1e-6)


def test_slack_is_no_force():
    prepared = online.prepare(model(NOISES[2]))
    rng = np.random.default_rng(0)
    time = np.arange(1000) / 1000.0
    result = online.run(prepared, time, rng.normal(0.0, 0.05, 1000), np.zeros(1000))
    slack = result.status & Status.SLACK != 0
    assert slack.mean() > 0.99
    assert (result.distal_tension[slack] < 1e-6).all()
    assert (result.phase[slack] == Phase.SLACK).all()


def test_profile_is_that_of_the_chain():
    section = SHEATH.sections[0]
    chain = Chain([(section.length, section.radius)], SHEATH.friction, 9000.0, beads=80)
    prepared = online.prepare(model())
    state = online.build_initial_state(prepared)
    for q in np.concatenate([np.linspace(0, 1.6e-3, 200), np.linspace(1.6e-3, 1.2e-3, 100)]):
        chain.move(Position(q), Position(0.0))
        result, state = online.step(prepared, state, chain.T_in, q, 1.0 / RATE)
    places = np.concatenate([[0.0], (np.cumsum(chain.lengths) - chain.lengths / 2)[1:-1], [1.5]])
    profile = online.compute_profile(prepared, state, places)
    assert profile == pytest.approx(chain.tensions, rel=0.01)
    assert profile[0] == pytest.approx(result.distal_tension * profile[0] / profile[-1])
    assert result.phase == Phase.PULL_TO_RELEASE
    peak = places[np.argmax(chain.tensions)]
    assert result.front == pytest.approx(peak, abs=0.03)


def test_tendons_of_a_rig_are_estimated_as_each_alone():
    """Records in an array share no memory: what one is given never shows in another."""
    record = scenario("tip is drawn out after a pull")
    T, q = measure(record, NOISES[1])
    models = [model(NOISES[1], sheath, initial=5.0) for sheath in SHEATHS]
    prepared = online.prepare_all(models)
    states = online.build_initial_states(prepared)
    estimates = TendonEstimate.array(len(models))
    alone = [
        online.run(online.prepare(m), record.time, T * (1 + i), q) for i, m in enumerate(models)
    ]
    before = 0.0
    for k, t in enumerate(record.time):
        for i in range(len(models)):
            online.advance(
                view_struct(prepared, i),
                view_struct(states, i),
                T[k] * (1 + i),
                q[k],
                t - before if k else 0.0,
                view_struct(estimates, i),
            )
            for name, row in alone[i]._asdict().items():
                assert np.array_equal(row[k], estimates[name][i], equal_nan=True), (k, i, name)
        before = t


def dragged(tips, tension=0.4):
    """Return T_in, q_p and T_out of a tendon dragged to and fro by its tip at one T_in."""
    (section,) = SHEATH.sections
    chain = Chain(((section.length, section.radius),), SHEATH.friction, 9000.0, beads=40)
    chain.move(Position(0.001), Position(0.0))
    rows = []
    for tip in tips:
        chain.move(Force(tension), Position(tip))
        rows.append((chain.T_in, chain.travel[0], chain.T_out))
    return np.array(rows).T


@pytest.mark.parametrize("noise", NOISES[:2])
def test_a_loose_tendon_is_known_to_be_dragged_by_the_way_its_motor_pays_out(noise):
    """T_in does not change, so nothing else tells whether T_out is T_in e^-K or T_in e^K."""
    out_and_back = 0.004 * np.concatenate([np.linspace(0, -1, 1000), np.linspace(-1, 0, 1000)])
    T_in, q_p, T_out = dragged(out_and_back)
    rng = np.random.default_rng(0)
    measured = [x + rng.normal(0.0, n, len(x)) for x, n in zip((T_in, q_p), noise, strict=True)]
    result = online.run(online.prepare(model(noise)), 1e-3 * np.arange(len(T_in)), *measured)
    assert T_out.max() / T_out.min() > 6.0  # e^2K, of a T_in that stays
    surely = np.zeros(len(T_in), dtype=bool)
    surely[250:1000] = surely[1250:] = True  # the first millimetre may go by unseen
    error = np.abs(result.distal_tension - T_out)[surely]
    assert error.max() < 0.05 * T_out.max() + 8.0 * noise[0]


def test_a_tip_that_stops_is_not_taken_to_have_turned():
    """A T_in that stays for a while after a fall is no rise: T_out is still T_in e^-K."""
    prepared = online.prepare(model())
    state = online.build_initial_state(prepared)
    falls = np.repeat(np.arange(10.0, 6.0, -0.05), 10)  # [N] in steps, as a coarse cell gives them
    pull = np.linspace(0.0, 10.0, 200)
    T_in = np.concatenate([pull, falls])
    M_pull = 1.5 * (1.0 - math.exp(-1.0)) / 9000.0
    q_p = np.concatenate([M_pull * pull, np.full(len(falls), M_pull * 10.0)])
    tip_moved = 0
    for k, (T, q) in enumerate(zip(T_in, q_p, strict=True)):
        estimate_now, state = online.step(prepared, state, T, q, 1e-3 if k else 0.0)
        assert estimate_now.distal_tension < 10.0 * math.exp(-1.0) * 1.01
        tip_moved += bool(estimate_now.status & Status.TIP_MOVED)
    assert tip_moved > 300
    assert estimate_now.distal_tension == pytest.approx(T_in[-1] * math.exp(-1.0), rel=0.02)


def test_interval_is_tight_while_the_whole_tendon_slides_and_opens_after():
    legs = [(0.3, 3e-3, spring(2e3)), (1.0, 4e-3, spring(2e3)), (0.8, 0.0, held())]
    record = play(SHEATH, legs)
    result = estimate(record)
    sliding = np.flatnonzero(record.leg == 1)[-1]
    width = (result.high - result.low) / record.T_out
    assert width[sliding] < 0.2
    least, most = envelope(build_tables(SHEATH), record.T_in[-1])
    assert result.low[-1] == pytest.approx(least, rel=0.05)
    assert result.high[-1] == pytest.approx(most, rel=0.05)


def test_bad_from_the_first_sample_on_is_survived():
    prepared = online.prepare(model())
    estimate_, state = online.step(
        prepared, online.build_initial_state(prepared), math.nan, math.nan, 0.0
    )
    assert estimate_.status & Status.INVALID_INPUT
    assert estimate_.distal_tension == pytest.approx(0.0, abs=1e-6)
    after, _ = online.step(prepared, state, 3.0, 3e-4, 0.001)
    assert after.distal_tension == pytest.approx(3.0 / math.e, rel=1e-6)
