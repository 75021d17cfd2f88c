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
from estimator.routing.sheath_end import (
    SheathPair,
    drive_tip,
    estimate_sheath_ends,
    start_sheath_end,
)
from estimator.structs import view_struct
from studies.brute_force.chain import Chain, Force, Position

SHEATH = Sheath((Section(0.3), Section(0.5, 0.25), Section(0.1)), 0.12, 9000.0)
TABLES, PRETENSION, DT = build_tables(SHEATH), 2.0, 1e-3
ENCODER_NOISE = 1e-6  # [m], of a count


def play_pair(stiffness_error):
    """Return tensions at the tip, true and estimated by pair and by T_in alone, shape (n, 2)."""
    sections = [(section.length, section.radius) for section in SHEATH.sections]
    chains = [Chain(sections, SHEATH.friction, 9000.0, beads=30, tension=PRETENSION) for _ in "ab"]
    model = prepare(
        TendonModel(
            Sheath(SHEATH.sections, SHEATH.friction, 9000.0 * stiffness_error), initial=PRETENSION
        )
    )
    pair = view_struct(SheathPair.array())
    start = build_pretensioned_profile(TABLES, PRETENSION)
    alone = [start.copy(), start.copy()]
    for end in pair.end:
        start_sheath_end(end, start, PRETENSION)
    rows = []
    for i in range(700):  # the first pulls, its tip goes to and fro; the second is slack
        share = min(i / 100.0, 1.0)
        tensions = PRETENSION + share * np.array([6.0 + 4.0 * math.sin(0.013 * i), -1.6])
        x = share * 6e-4 * math.sin(0.03 * i)
        for chain, T, tip in zip(chains, tensions, (x, -x), strict=True):
            chain.move(Force(T), Position(tip))
        readings = [(T, chain.travel[0]) for T, chain in zip(tensions, chains, strict=True)]
        ends = estimate_sheath_ends(pair, model, model, *readings, 0.02, x, (0.0, 0.0), DT)
        for profile, T in zip(alone, tensions, strict=True):
            push_proximal(TABLES, profile, T)
        rows.append([[c.T_out for c in chains], ends, [read_profile(TABLES, p)[1] for p in alone]])
    return np.array(rows[100:]).transpose(1, 0, 2)


@pytest.mark.parametrize("stiffness_error", [1.0, 0.9])
def test_a_pair_shows_that_its_tips_move_before_either_tendon_slides_through(
    stiffness_error,
):
    true, pair, alone = play_pair(stiffness_error)
    error = np.abs(pair - true)
    assert error.max() < 0.8  # [N] of up to 14 N
    assert error.mean() < 0.05
    assert np.abs(alone - true).max() > 4.0  # the tip has moved, and T_in does not tell


def test_tips_that_stick_keep_their_tension_while_the_motors_sway():
    """By less than friction holds back; noise of the load cells is no motion of the tips."""
    noise, random = 0.02, np.random.default_rng(7)
    sections = [(section.length, section.radius) for section in SHEATH.sections]
    chains = [Chain(sections, SHEATH.friction, 9000.0, beads=30, tension=PRETENSION) for _ in "ab"]
    model = prepare(TendonModel(SHEATH, initial=PRETENSION, tension_noise=noise))
    pair = view_struct(SheathPair.array())
    for end in pair.end:
        start_sheath_end(end, build_pretensioned_profile(TABLES, PRETENSION), PRETENSION)
    ends = []
    for i in range(1500):  # at 10 Hz
        sway = 0.3 * math.sin(0.063 * i)
        for chain, T in zip(chains, (PRETENSION + sway, PRETENSION - sway), strict=True):
            chain.move(Force(T), Position(0.0))
        tensions = [chain.T_in + noise * random.standard_normal() for chain in chains]
        readings = [(T, chain.travel[0]) for T, chain in zip(tensions, chains, strict=True)]
        ends.append(estimate_sheath_ends(pair, model, model, *readings, 0.5, 0.0, (0.0, 0.0), DT))
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
    pair = view_struct(SheathPair.array())
    for end in pair.end:
        start_sheath_end(end, build_pretensioned_profile(TABLES, PRETENSION), PRETENSION)
    errors = []
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
        estimate_sheath_ends(pair, model, model, *readings, share, x, (0.0, 0.0), DT)
        errors.append(pair.travel - x)
    change = np.array(errors[100:]) - np.mean(errors[100:])
    assert np.quantile(np.abs(change), 0.9) < error_max  # [m]


@given(st.floats(0.5, 20.0), st.lists(st.floats(-2e-4, 2e-4), min_size=1, max_size=20))
@example(12.0, [1.4e-4, -1e-15, 5.3e-5])  # a reversal too small to be seen
@example(9.0, [1.4e-4, -1.2e-7, 1e-7, 9.7e-6])  # ... and back in two steps
def test_the_tip_stretches_the_tendon_within_what_friction_holds(tension, stretches):
    profile = build_pretensioned_profile(TABLES, 3.0)
    push_proximal(TABLES, profile, tension)
    left = 0.0
    for stretch in stretches:
        before = read_profile(TABLES, profile)
        wanted = stretch if left * stretch < 0.0 else left + stretch
        left = drive_tip(TABLES, profile, tension, wanted)
        T_in, T_out, elongation = read_profile(TABLES, profile)[:3]
        assert T_in == pytest.approx(tension)
        assert abs(math.log(T_out / T_in)) <= SHEATH.K + 1e-9
        assert (T_out - before[1]) * wanted >= 0.0
        is_limited = abs(math.log(T_out / T_in)) > SHEATH.K - 1e-9
        if not is_limited:
            assert elongation - before[2] == pytest.approx(wanted - left, abs=1e-12)
            assert abs(left) <= 0.25 * abs(wanted) + 1e-12
