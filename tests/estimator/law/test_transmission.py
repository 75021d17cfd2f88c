"""The transmission law against the brute-force chain, a node sweep, and its own properties."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from estimator.law.play_profile import count_points, get_point
from estimator.law.sheath import Section, Sheath, SheathError
from estimator.law.transmission import (
    CAPACITY,
    Phase,
    build_pretensioned_profile,
    build_slack_profile,
    build_tables,
    drive_proximal,
    evaluate_tension,
    get_merge_error_bound,
    observe,
    push_displacement,
    push_displacement_spring,
    push_distal,
    push_proximal,
    read_profile,
    simulate_tensions,
)
from studies.brute_force.chain import Chain, Force, Position, Spring
from tests.estimator.law.bounds import certified_interval, envelope

MU, EA = 0.1, 9000.0
UNIFORM = ((1.5, 0.15),)  # K = 1
BENT = ((0.5, 0.08), (0.4, math.inf), (0.3, 0.15), (0.3, 0.4))  # (length, radius) [m]
NESTED = (0.1, 20.0, 5.0, 15.0, 7.0, 12.0, 3.0, 9.0, 4.0, 18.0, 0.5, 20.0, 1.0)

TENSIONS = st.floats(0.2, 30.0)
HISTORIES = st.lists(TENSIONS, min_size=1, max_size=25)
MOVES = st.lists(st.tuples(st.sampled_from(["motor", "tip"]), TENSIONS), min_size=1, max_size=20)
SHEATHS = st.builds(
    Sheath,
    st.lists(
        st.builds(
            Section, st.floats(0.05, 0.6), st.one_of(st.just(math.inf), st.floats(0.03, 1.0))
        ),
        min_size=1,
        max_size=4,
    ).map(tuple),
    st.one_of(st.just(0.0), st.floats(0.02, 0.15)),
    st.just(EA),
    st.one_of(st.just(0.0), st.floats(0.01, 3.0)),
    st.one_of(st.just(1.0), st.floats(0.5, 2.0)),
).filter(lambda sheath: sheath.K < 3.0)


def examples(count):
    return settings(deadline=None, max_examples=count)


def sheath_of(sections, drag=0.0, asymmetry=1.0):
    return Sheath(tuple(Section(*section) for section in sections), MU, EA, drag, asymmetry)


def ramps(levels, steps=12):
    """Return the way through `levels` in small steps, the first level included."""
    parts = [np.linspace(a, b, steps + 1)[1:] for a, b in itertools.pairwise(levels)]
    return np.concatenate([[levels[0]], *parts])


def driven(table, profile, moves):
    profile = profile.copy()
    for end, tension in moves:
        {"motor": push_proximal, "tip": push_distal}[end](table, profile, tension)
    return profile


def after(table, tensions, start=5.0):
    profile = build_pretensioned_profile(table, start)
    for tension in tensions:
        push_proximal(table, profile, tension)
    return profile


def points(profile):
    return [get_point(profile, k) for k in range(count_points(profile))]


def same(table, one, other):
    """Whether two profiles are the same state, told by what both ends and the inside show."""
    x = np.linspace(0.0, table[1], 50)
    inside = np.allclose(
        evaluate_tension(table, one, x), evaluate_tension(table, other, x), rtol=1e-9
    )
    return inside and np.allclose(
        read_profile(table, one)[:3], read_profile(table, other)[:3], rtol=1e-9
    )


def worst(model, truth):
    """Largest error over the largest true value."""
    return np.abs(np.array(model) - np.array(truth)).max() / np.abs(truth).max()


# Against the chain: 1e-3 of full scale.


@pytest.mark.parametrize(
    ("sections", "drag", "asymmetry", "start"),
    [
        (UNIFORM, 0.0, 1.0, 0.0),
        pytest.param(BENT, 2.0, 1.0, 0.0, marks=pytest.mark.slow),
        (BENT[::-1], 0.0, 1.5, 0.0),
        (BENT, 1.0, 0.7, 4.0),
    ],
)
def test_motor_driven_by_force(sections, drag, asymmetry, start):
    chain = Chain(sections, MU, EA, beads=200, drag=drag, asymmetry=asymmetry, tension=start)
    table = build_tables(sheath_of(sections, drag, asymmetry))
    profile = build_pretensioned_profile(table, start)
    levels = (start, *NESTED[1:]) if start else NESTED
    model, truth = [], []
    for tension in ramps(levels):
        chain.move(Force(tension), Position(0.0))
        push_proximal(table, profile, tension)
        seen = observe(table, profile)
        model.append((seen.T_out, seen.elongation))
        truth.append((chain.T_out, chain.elongation))
    for column in (0, 1):
        assert worst(np.array(model)[:, column], np.array(truth)[:, column]) < 1e-3


@pytest.mark.parametrize(
    ("sections", "drag"), [pytest.param(UNIFORM, 0.0, marks=pytest.mark.slow), (BENT, 1.0)]
)
def test_motor_driven_by_travel_with_the_tip_held(sections, drag):
    chain = Chain(sections, MU, EA, beads=200, drag=drag)
    chain.travel += 0.01
    table = build_tables(sheath_of(sections, drag))
    profile = build_slack_profile(table)
    model, truth = [], []
    for travel in ramps([1e-5, 2e-3, 1.4e-3, 1.8e-3, 1.5e-3, 2.2e-3, 6e-4, 2e-3]):
        chain.move(Position(travel + 0.01), Position(0.01))
        push_displacement(table, profile, travel + 0.01, 0.01)
        seen = observe(table, profile)
        assert seen.elongation == pytest.approx(travel, rel=1e-9)
        model.append((seen.T_in, seen.T_out))
        truth.append((chain.T_in, chain.T_out))
    assert worst(model, truth) < 1e-3


@pytest.mark.parametrize(
    ("sections", "drag"), [pytest.param(UNIFORM, 0.0, marks=pytest.mark.slow), (BENT, 1.0)]
)
def test_motor_driven_by_travel_against_a_spring(sections, drag):
    stiffness, rest = 2000.0, 0.01
    chain = Chain(sections, MU, EA, beads=200, drag=drag)
    chain.travel += rest
    table = build_tables(sheath_of(sections, drag))
    profile = build_slack_profile(table)
    model, truth = [], []
    for travel in ramps([1e-5, 6e-3, 4.5e-3, 5.5e-3, 4.8e-3, 7e-3, 1e-3, 6e-3]):
        chain.move(Position(rest + travel), Spring(stiffness, rest))
        push_displacement_spring(table, profile, rest + travel, rest, stiffness)
        seen = observe(table, profile)
        assert seen.elongation + seen.T_out / stiffness == pytest.approx(travel, rel=1e-9)
        model.append((seen.T_in, seen.T_out, 1e3 * seen.elongation))
        truth.append((chain.T_in, chain.T_out, 1e3 * chain.elongation))
    for column in range(3):
        assert worst(np.array(model)[:, column], np.array(truth)[:, column]) < 1e-3


@pytest.mark.parametrize(("sections", "drag"), [(UNIFORM, 0.0), (BENT, 1.0)])
@pytest.mark.parametrize(
    "motor", [pytest.param((0.1, 30.0, 2.0), marks=pytest.mark.slow), (0.1, 30.0, 8.0, 20.0, 12.0)]
)
@pytest.mark.parametrize("tip", [(30.0, 1.5, 9.0, 4.0), (2.0, 25.0, 6.0, 11.0)])
def test_tip_driven_after_the_motor(sections, motor, tip, drag):
    asymmetry = 1.3
    chain = Chain(sections, MU, EA, beads=200, drag=drag, asymmetry=asymmetry)
    table = build_tables(sheath_of(sections, drag, asymmetry))
    profile = build_pretensioned_profile(table, 0.0)
    for tension in ramps(motor):
        chain.move(Force(tension), Position(0.0))
        push_proximal(table, profile, tension)
    held = Position(chain.travel[0])
    model, truth = [], []
    for tension in ramps((chain.T_out, *tip)):
        chain.move(held, Force(tension))
        push_distal(table, profile, tension)
        seen = observe(table, profile)
        model.append((seen.T_in, 1e3 * seen.elongation))
        truth.append((chain.T_in, 1e3 * chain.elongation))
    for column in (0, 1):
        assert worst(np.array(model)[:, column], np.array(truth)[:, column]) < 1e-3


@pytest.mark.parametrize("motor", [(0.1, 20.0, 9.0), (0.1, 20.0, 2.0, 6.0, 4.0)])
@pytest.mark.parametrize("up", [False, True])
def test_certified_interval_is_how_far_the_tip_can_go_unseen(motor, up):
    beads, sections = 200, UNIFORM
    chain = Chain(sections, MU, EA, beads=beads)
    table = build_tables(sheath_of(sections))
    profile = build_slack_profile(table)
    for tension in ramps(motor):
        chain.move(Force(tension), Position(0.0))
        push_proximal(table, profile, tension)
    seen = observe(table, profile)
    near = slice(0, max(1, round(seen.front / sections[0][0] * beads) - 2))
    certain = chain.tensions[near]
    T_in, held = chain.T_in, Position(chain.travel[0])
    reached_front = reached_housing = None
    for tension in chain.T_out * (1.01 if up else 1 / 1.01) ** np.arange(400):
        chain.move(held, Force(tension))
        if reached_front is None and np.abs(chain.tensions[near] / certain - 1).max() > 1e-6:
            reached_front = tension
        if abs(chain.T_in / T_in - 1) > 1e-6:
            reached_housing = tension
            break
    assert certified_interval(table, profile)[up] == pytest.approx(reached_front, rel=0.04)
    assert envelope(table, T_in)[up] == pytest.approx(reached_housing, rel=0.02)


# Against a sweep of clipped nodes: the operator in its most naive form.


@examples(60)
@given(SHEATHS, TENSIONS, MOVES)
def test_profile_equals_a_sweep_of_clipped_nodes(sheath, start, moves):
    assume(sheath.K > 0.0)
    table = build_tables(sheath)
    x = np.linspace(0.0, sheath.length, 400)
    angle = np.zeros_like(x)
    edge = 0.0
    for section in sheath.sections:
        angle += np.clip(x - edge, 0.0, section.length) / section.radius
        edge += section.length
    steps = np.diff(sheath.friction * angle)
    down, up = np.exp(-steps), np.exp(sheath.asymmetry * steps)
    nodes = np.full(x.size, start + sheath.drag)
    for end, tension in moves:
        if end == "motor":
            nodes[0] = tension + sheath.drag
            for k in range(steps.size):
                nodes[k + 1] = min(max(nodes[k + 1], nodes[k] * down[k]), nodes[k] * up[k])
        else:
            nodes[-1] = tension + sheath.drag
            for k in reversed(range(steps.size)):
                nodes[k] = min(max(nodes[k], nodes[k + 1] / up[k]), nodes[k + 1] / down[k])
    profile = driven(table, build_pretensioned_profile(table, start), moves)
    assert evaluate_tension(table, profile, x) == pytest.approx(
        nodes - sheath.drag, rel=1e-6, abs=1e-6
    )


# Properties over any history.


@examples(100)
@given(SHEATHS, TENSIONS, MOVES)
def test_friction_bounds_the_profile_everywhere(sheath, start, moves):
    table = build_tables(sheath)
    profile = driven(table, build_pretensioned_profile(table, start), moves)
    for (s_a, y_a, slope), (s_b, y_b, _) in itertools.pairwise(points(profile)):
        assert s_b >= s_a
        assert -(s_b - s_a) - 1e-9 <= y_b - y_a <= sheath.asymmetry * (s_b - s_a) + 1e-9
        assert y_b - y_a == pytest.approx(slope * (s_b - s_a), abs=1e-9)
    seen = observe(table, profile)
    low, high = envelope(table, seen.T_in)
    inner_low, inner_high = certified_interval(table, profile)
    ordered = [low, inner_low, seen.T_out, inner_high, high]
    assert all(a <= b * (1 + 1e-9) + 1e-9 for a, b in itertools.pairwise(ordered))
    if seen.phase in {Phase.PULL, Phase.RELEASE}:
        assert inner_low == pytest.approx(inner_high)


@examples(60)
@given(SHEATHS, TENSIONS, MOVES)
def test_elongation_is_the_integral_of_the_strain(sheath, start, moves):
    table = build_tables(sheath)
    profile = driven(table, build_pretensioned_profile(table, start), moves)
    x = (np.arange(20000) + 0.5) * sheath.length / 20000
    area = evaluate_tension(table, profile, x).mean() * sheath.length
    assert observe(table, profile).elongation == pytest.approx(area / EA, rel=1e-4)


@examples(60)
@given(SHEATHS, MOVES, HISTORIES)
def test_batch_is_the_step_repeated(sheath, moves, history):
    table = build_tables(sheath)
    profile = driven(table, build_pretensioned_profile(table, 5.0), moves)
    stepped, expected = profile.copy(), []
    for tension in history:
        stepped = drive_proximal(table, stepped, tension)
        expected.append(observe(table, stepped)[1:3])
    T_out, elongation = simulate_tensions(table, profile, np.array(history))
    assert np.array_equal(np.array([T_out, elongation]).T, np.array(expected))
    assert np.array_equal(profile, stepped)


@examples(100)
@given(SHEATHS, MOVES, TENSIONS)
def test_travel_and_force_drive_the_same_transmission(sheath, moves, tension):
    table = build_tables(sheath)
    profile = driven(table, build_pretensioned_profile(table, 5.0), moves)
    by_force = drive_proximal(table, profile, tension)
    by_travel, by_spring = profile.copy(), profile.copy()
    wanted = observe(table, by_force)
    push_displacement(table, by_travel, 0.3 + wanted.elongation, 0.3)
    q_p = 0.3 + wanted.elongation + wanted.T_out / 500.0
    push_displacement_spring(table, by_spring, q_p, 0.3, 500.0)
    for profile in (by_travel, by_spring):
        seen = observe(table, profile)
        assert seen.T_in == pytest.approx(tension, rel=1e-5)
        assert seen.T_out == pytest.approx(wanted.T_out, rel=1e-5)
        assert seen.elongation == pytest.approx(wanted.elongation, rel=1e-9)


# Limits and single facts.


@examples(40)
@given(HISTORIES, st.sampled_from([0.0, 1e-12]))
def test_without_friction_the_tip_is_the_housing(history, K):
    sheath = Sheath.uniform(K, 1.5, EA)
    table = build_tables(sheath)
    seen = observe(table, after(table, history))
    assert seen.T_out == pytest.approx(seen.T_in)
    assert seen.elongation == pytest.approx(seen.T_in * 1.5 / EA)
    profile = build_slack_profile(table)
    push_displacement(table, profile, 1e-3, 0.0)
    assert observe(table, profile).T_in == pytest.approx(1e-3 * EA / 1.5)
    push_distal(table, profile, 3.0)
    assert observe(table, profile).T_in == pytest.approx(3.0)


def test_phases_and_front_of_one_pull_and_release():
    table = build_tables(Sheath.uniform(1.0, 1.5, EA))
    profile = build_slack_profile(table)
    assert observe(table, profile).phase == Phase.SLACK
    for tension, phase, front in [
        (20.0, Phase.PULL, 1.5),
        (20.0 * math.exp(-1.0), Phase.PULL_TO_RELEASE, 0.75),
        (20.0 * math.exp(-2.5), Phase.RELEASE, 1.5),
        (20.0 * math.exp(-2.1), Phase.RELEASE_TO_PULL, 0.3),
        (30.0, Phase.PULL, 1.5),
        (0.0, Phase.SLACK, 1.5),
    ]:
        profile = drive_proximal(table, profile, tension)
        seen = observe(table, profile)
        assert (seen.phase, seen.front) == (phase, pytest.approx(front))
    assert seen.T_out == pytest.approx(0.0, abs=1e-6)
    profile = build_pretensioned_profile(table, 5.0)
    assert (observe(table, profile).phase, observe(table, profile).front) == (Phase.VIRGIN, 0.0)
    profile = drive_proximal(table, profile, 5.0 * math.exp(0.5))
    assert observe(table, profile).phase == Phase.VIRGIN
    assert observe(table, profile).front == pytest.approx(0.75)
    profile = drive_proximal(table, profile, 5.0 * math.exp(1.1))
    assert observe(table, profile).phase == Phase.PULL


@examples(60)
@given(SHEATHS, HISTORIES)
def test_holding_a_travel_plants_no_reversals(sheath, history):
    table = build_tables(sheath)
    profile = after(table, history)
    for travel in 1e-4 * np.array(history):
        push_displacement(table, profile, travel, 0.0)
        held = profile.copy()
        for _ in range(3):
            push_displacement(table, profile, travel, 0.0)
        assert np.array_equal(profile, held)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_stays_outside(bad):
    table = build_tables(sheath_of(UNIFORM))
    profile = after(table, [20.0, 8.0])
    before = profile.copy()
    push_proximal(table, profile, bad)
    push_distal(table, profile, bad)
    push_displacement(table, profile, bad, 0.0)
    push_displacement_spring(table, profile, bad, 0.0, 1e3)
    assert np.array_equal(profile, before)
    with pytest.raises(SheathError, match="finite"):
        drive_proximal(table, profile, bad)
    with pytest.raises(ValueError, match="finite"):
        simulate_tensions(table, profile, np.array([1.0, bad]))
    with pytest.raises(SheathError, match="pretension"):
        build_pretensioned_profile(table, bad)


def test_a_full_profile_errs_by_no_more_than_it_says():
    K = 6.0
    table = build_tables(Sheath.uniform(K, 1.5, EA))
    profile = after(table, [200.0, 1e-3])
    x = np.linspace(0.0, 1.5, 3000)
    step = math.exp(-K / (x.size - 1))
    nodes = 1e-3 * step ** -np.arange(x.size)
    swings = 0.99 * K * (1.0 - np.arange(1.5 * CAPACITY) / (1.5 * CAPACITY + 20)) ** 2
    told = []
    for k, swing in enumerate(swings):
        nodes[0] = 10.0 * math.exp((-1) ** k * swing)
        smallest = min(b[0] - a[0] for a, b in itertools.pairwise(points(profile)))
        push_proximal(table, profile, nodes[0])
        for j in range(x.size - 1):
            nodes[j + 1] = min(max(nodes[j + 1], nodes[j] * step), nodes[j] / step)
        error = np.abs(np.log(evaluate_tension(table, profile, x) / nodes)).max()
        if get_merge_error_bound(profile) > (told[-1] if told else 0.0):
            told.append(get_merge_error_bound(profile))
            if len(told) == 1:
                assert error == pytest.approx(told[0], rel=0.15)
                assert told[0] <= 2.2 * smallest
            assert told[-1] <= len(told) * 2.0 * K / (CAPACITY - 6)
        assert error <= get_merge_error_bound(profile) + 1e-9
        assert count_points(profile) < CAPACITY
    assert len(told) > 3
    for (s_a, y_a, slope), (s_b, y_b, _) in itertools.pairwise(points(profile)):
        assert y_b - y_a == pytest.approx(slope * (s_b - s_a), abs=1e-9)
    seen = observe(table, profile)
    assert (seen.T_in, seen.T_out) == pytest.approx((nodes[0], nodes[-1]))
    area = evaluate_tension(table, profile, (np.arange(20000) + 0.5) * 1.5 / 20000).mean() * 1.5
    assert seen.elongation == pytest.approx(area / EA, rel=1e-4)
    push_proximal(table, profile, 1e5)
    assert get_merge_error_bound(profile) == 0.0


def test_a_long_noisy_history_does_not_drift():
    table = build_tables(sheath_of(BENT, drag=0.3, asymmetry=1.2))
    noise = np.random.default_rng(1).normal(0.0, 0.05, 400_000)
    tensions = 10.0 + 3.0 * np.sin(np.arange(noise.size) / 300.0) + noise
    profile = build_slack_profile(table)
    push_proximal(table, profile, 20.0)
    elongation = simulate_tensions(table, profile, tensions)[1][-1]
    x = (np.arange(200_000) + 0.5) * 1.5 / 200_000
    assert elongation == pytest.approx(
        evaluate_tension(table, profile, x).mean() * 1.5 / EA, rel=1e-7
    )
