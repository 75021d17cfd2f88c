"""Both ends of the sheaths of a pair, against the brute-force chain, and limits of the tip."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from estimator.law.play_profile import build_pretensioned_profile, push_proximal
from estimator.law.sheath import Section, Sheath
from estimator.law.tables import build_tables
from estimator.law.transmission import read_profile
from estimator.online.estimator_state import prepare
from estimator.online.tendon_model import TendonModel
from estimator.routing.routing import Routing
from estimator.routing.routing import prepare as prepare_routing
from estimator.routing.sheath_end import (
    SheathPair,
    drive_sheath_end,
    start_sheath_end,
    update_pair_travel,
)
from estimator.routing.tensions import advance, begin_advance, compute_excess, open_tensions
from estimator.structs import view_struct
from studies.brute_force.chain import Chain, Force, Position
from studies.brute_force.routed import Pin, RoutedChain

SHEATH = Sheath((Section(0.3), Section(0.5, 0.25), Section(0.1)), 0.12, 9000.0)
TABLES, PRETENSION, DT = build_tables(SHEATH), 2.0, 1e-3
ENCODER_NOISE = 1e-6  # [m], of a count


RADIUS, SPAN = 0.005, 0.1  # [m] of the joint that moves; of tendon behind each joint


class PairInArm:
    """A pair whose tendons pass a joint that rests, with friction, and end at the next."""

    def __init__(self, model, span=1e-6, wrap=0.5):
        self.model = model
        self.routing = prepare_routing(
            Routing(
                [[0.004, RADIUS], [0.004, -RADIUS]],
                friction=[[0.2, 0.0]] * 2,
                wrap=wrap,
                side=[[-1, 0]] * 2,
                span=span,
                spring_stiffness=[1.0, 0.0],
                pin_elements=5,
            )
        )
        rows = len(self.routing.joint)
        self.tensions, self.reported = np.empty((3, rows)), np.empty((3, rows))
        self.angles = np.zeros((2, 2))
        sheath_ends = np.full((3, 2), PRETENSION)
        open_tensions(self.routing, sheath_ends, self.angles[0], self.tensions)
        self.pair = view_struct(SheathPair.array())
        for end in self.pair.end:
            profile = build_pretensioned_profile(TABLES, PRETENSION)
            start_sheath_end(end, profile, PRETENSION)
        self.excess = np.zeros(2)

    def step(self, readings, share, known_travel):
        """Take readings (T_in, q_p); return the tensions at the sheaths' ends."""
        (T_a, q_a), (T_b, q_b) = readings
        update_pair_travel(
            self.pair,
            self.model,
            self.model,
            (T_a, q_a - self.excess[0]),
            (T_b, q_b - self.excess[1]),
            share,
            known_travel,
            DT,
        )
        return self.turn(self.pair.travel)

    def turn(self, travel):
        """Turn the joint to a `travel` [m]; return the tensions at the sheaths' ends."""
        new = np.array([[0.0, travel / RADIUS]] * 2)
        elements = begin_advance(self.routing, self.tensions, self.angles, new)
        ends = [
            drive_sheath_end(self.model, end, self.routing, elements, i, self.tensions[0])
            for i, end in enumerate(self.pair.end)
        ]
        driven = self.tensions, self.angles, np.tile(ends, (3, 1)), new, self.reported
        advance(self.routing, elements, *driven)
        compute_excess(self.routing, elements, self.reported[0], self.excess)
        return ends


def play_pair(stiffness_error, span=1e-6):
    """Return tensions at the sheaths' ends, true, by pair and by T_in alone, shape (n, 2)."""
    sections = [(section.length, section.radius) for section in SHEATH.sections]
    chains = [
        RoutedChain(
            sections, SHEATH.friction, 9000.0,
            [Pin(0, 0.004, 0.2, 0.5, span), Pin(1, arm, 0.0, 1.5, span)],
            [0.0, 0.0], PRETENSION, beads=30,
        )
        for arm in (RADIUS, -RADIUS)
    ]  # fmt: skip
    model = prepare(
        TendonModel(
            Sheath(
                (*SHEATH.sections, Section(2.0 * span)), SHEATH.friction, 9000.0 * stiffness_error
            ),
            initial=PRETENSION,
        )
    )
    pair = PairInArm(model, span)
    alone = [build_pretensioned_profile(TABLES, PRETENSION) for _ in "ab"]
    rows = []
    for i in range(700):  # the first pulls, its tip goes to and fro; the second is slack
        share = min(i / 100.0, 1.0)
        tensions = PRETENSION + share * np.array([6.0 + 4.0 * math.sin(0.013 * i), -1.6])
        x = share * 6e-4 * math.sin(0.03 * i)
        for chain, T in zip(chains, tensions, strict=True):
            chain.move_to(T, [0.0, x / RADIUS])
        readings = [(T, chain.motor_travel) for T, chain in zip(tensions, chains, strict=True)]
        ends = pair.step(readings, 0.02, x)
        for profile, T in zip(alone, tensions, strict=True):
            push_proximal(TABLES, profile, T)
        true = [chain.sheath_end_tension for chain in chains]
        rows.append([true, ends, [read_profile(TABLES, p)[1] for p in alone]])
    return np.array(rows[100:]).transpose(1, 0, 2)


@pytest.mark.parametrize(("stiffness_error", "span"), [(1.0, 1e-6), (0.9, 1e-6), (1.0, SPAN)])
def test_a_pair_shows_that_its_tips_move_before_either_tendon_slides_through(stiffness_error, span):
    """Also where the tendons stretch behind their sheaths, as far as a guide lets them."""
    true, pair, alone = play_pair(stiffness_error, span)
    error = np.abs(pair - true)
    assert error.max() < 0.8  # [N] of up to 14 N
    assert error.mean() < 0.05
    assert np.abs(alone - true).max() > 4.0  # the tip has moved, and T_in does not tell


def test_a_sample_that_is_not_finite_leaves_the_next_ones_finite():
    arm = PairInArm(prepare(TendonModel(SHEATH, initial=PRETENSION)), SPAN)
    arm.turn(1e-4)
    arm.tensions[0] = np.inf  # as `advance` leaves them
    compute_excess(arm.routing, begin_advance(arm.routing, arm.tensions, arm.angles, arm.angles),
                   arm.tensions[0], arm.excess)  # fmt: skip
    assert arm.excess.tolist() == [0.0, 0.0]
    for travel in (2e-4, 3e-4):
        assert np.isfinite(arm.turn(travel)).all()
        assert np.isfinite(arm.excess).all()


@pytest.mark.parametrize("stretch", [np.nan, np.inf, -np.inf])
def test_a_stretch_that_is_not_finite_leaves_the_tension_where_it_is(stretch):
    arm = PairInArm(prepare(TendonModel(SHEATH, initial=PRETENSION)), SPAN)
    before = arm.turn(1e-4)
    elements = begin_advance(arm.routing, arm.tensions, arm.angles, arm.angles)
    for i in range(2):
        end = arm.pair.end[i]
        end.stretch = stretch
        found = drive_sheath_end(arm.model, end, arm.routing, elements, i, arm.tensions[0])
        assert found == pytest.approx(before[i], rel=1e-6)
    assert np.isfinite(arm.turn(2e-4)).all()


def test_tips_that_stick_keep_their_tension_while_the_motors_sway():
    """By less than friction holds back; noise of the load cells is no motion of the tips."""
    noise, random = 0.02, np.random.default_rng(7)
    sections = [(section.length, section.radius) for section in SHEATH.sections]
    chains = [Chain(sections, SHEATH.friction, 9000.0, beads=30, tension=PRETENSION) for _ in "ab"]
    model = prepare(TendonModel(SHEATH, initial=PRETENSION, tension_noise=noise))
    pair, ends = PairInArm(model), []
    for i in range(1500):  # at 10 Hz
        sway = 0.3 * math.sin(0.063 * i)
        for chain, T in zip(chains, (PRETENSION + sway, PRETENSION - sway), strict=True):
            chain.move(Force(T), Position(0.0))
        tensions = [chain.T_in + noise * random.standard_normal() for chain in chains]
        readings = [(T, chain.travel[0]) for T, chain in zip(tensions, chains, strict=True)]
        ends.append(pair.step(readings, 0.5, 0.0))
        assert [chain.T_out for chain in chains] == pytest.approx([PRETENSION] * 2, abs=1e-6)
    assert np.ptp(ends[100:], axis=0).max() < 0.05  # [N]


@pytest.mark.parametrize(("is_slack", "error_max"), [(False, 1.2e-5), (True, 8e-5)])
def test_the_travel_of_tips_that_move_is_known_to_a_few_micrometres(is_slack, error_max):
    """Also once a tendon is taut that was slack, and whose motor turned by itself meanwhile."""
    noise, random = 0.02, np.random.default_rng(3)
    sections = [(section.length, section.radius) for section in SHEATH.sections]
    chains = [Chain(sections, SHEATH.friction, 9000.0, beads=30, tension=PRETENSION) for _ in "ab"]
    model = prepare(
        TendonModel(
            SHEATH, initial=PRETENSION, tension_noise=noise, displacement_noise=ENCODER_NOISE
        )
    )
    pair, errors = PairInArm(model), []
    for i in range(900):  # tips of up to 5 mm/s
        x, slack = 1e-3 * math.sin(0.005 * i), 0.0
        pulls = [9.0 + 3.0 * math.sin(0.004 * i), 1.5]
        if is_slack:
            pulls[1] = 1.5 * max(math.cos(0.01 * i), 0.0)
            slack = 2e-3 * max(-math.cos(0.01 * i), 0.0)
        for chain, T, tip in zip(chains, pulls, (x, -x), strict=True):
            chain.move(Force(T), Position(tip))
        readings = [
            (max(T + noise * random.standard_normal(), 0.0), 1e-6 * round(1e6 * chain.travel[0]))
            for T, chain in zip(pulls, chains, strict=True)
        ]
        readings[1] = (readings[1][0], readings[1][1] - slack)
        share = 1.0 if pulls[1] < 0.05 else 0.02
        pair.step(readings, share, x)
        errors.append(pair.pair.travel - x)
    change = np.array(errors[100:]) - np.mean(errors[100:])
    assert np.quantile(np.abs(change), 0.9) < error_max  # [m]


@given(st.floats(0.5, 20.0), st.lists(st.floats(-2e-4, 2e-4), min_size=1, max_size=20))
@example(12.0, [1.4e-4, -1e-15, 5.3e-5])  # a reversal too small to be seen
@example(9.0, [1.4e-4, -1.2e-7, 1e-7, 9.7e-6])  # ... and back in two steps
def test_the_tip_stretches_the_tendon_within_what_friction_holds(tension, stretches):
    arm = PairInArm(prepare(TendonModel(SHEATH, initial=PRETENSION)), wrap=0.0)
    end, travel = arm.pair.end[0], 0.0
    push_proximal(TABLES, end.profile, tension)
    end.held_tension = tension
    arm.turn(travel)
    for stretch in stretches:
        before, left = read_profile(TABLES, end.profile), end.stretch
        stretch = travel - (travel - stretch)  # noqa: PLW2901 - without what rounding takes
        travel -= stretch
        arm.turn(travel)
        wanted = left + stretch
        T_in, T_out, elongation = read_profile(TABLES, end.profile)[:3]
        assert T_in == pytest.approx(tension)
        assert abs(math.log(T_out / T_in)) <= SHEATH.K + 1e-9
        assert (T_out - before[1]) * wanted >= 0.0
        is_limited = abs(math.log(T_out / T_in)) > SHEATH.K - 1e-9
        if not is_limited:
            assert elongation - before[2] == pytest.approx(wanted - end.stretch, abs=2e-9)
            assert abs(end.stretch) <= 0.25 * abs(wanted) + 2e-9 or wanted * stretch <= 0.0
