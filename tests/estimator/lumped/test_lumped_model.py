"""The law on nodes: against the closed law, and against chains of beads that know no law."""

import numpy as np
import pytest

from estimator.law.sheath import Sheath
from estimator.law.transmission import build_slack_profile, build_tables, simulate_tensions
from estimator.lumped.lumped_model import (
    DrivenTendon,
    Physics,
    simulate_by_tension,
    simulate_by_travel,
)
from estimator.lumped.nodes import PLACES, build_even_weights
from studies import hidden_effects
from studies.brute_force.chain import Chain, Force, Position, Spring

K, LENGTH, EA = 0.9, 1.5, 9e3
SECTIONS = [(LENGTH, 0.15 * LENGTH / K)]
TIME = np.arange(300) * 0.02
THRESHOLDS = PLACES[[15, 25, 32, 37, 40]] / PLACES[32]  # over K, at nodes
SPECTRUM = np.column_stack([THRESHOLDS, [0.2, 0.1, 0.4, 0.2, 0.1]])
DEPTHS = (0.0, 1.0, 0.1, 0.9, 0.3, 0.7, 0.02, 1.0, 0.5)  # of the largest travel, in turn


def nested(largest, least=0.0):
    """Return a travel [m] that turns again and again, at first from zero."""
    depths = np.array([0.0, *(max(depth, least) for depth in DEPTHS[1:])])
    return largest * np.interp(TIME, np.linspace(0.0, TIME[-1], len(depths)), depths)


def physics(**changes):
    return Physics(np.array([K]), LENGTH / EA, build_even_weights(), **changes)


def simulated(travel, **changes):
    return simulate_by_travel(physics(**changes), TIME, travel, np.gradient(travel, TIME))


def chain(**changes):
    return Chain(SECTIONS, 0.15, EA, beads=240, **changes)


def through(beads, travel, tip):
    """Return T_in, T_out and q_d of a chain of beads whose motor goes through a travel."""
    rows = []
    for q, held in zip(travel, tip, strict=True):
        beads.move(Position(float(q)), held)
        rows.append((max(beads.T_in, 0.0), max(beads.T_out, 0.0), beads.travel[-1]))
    return np.array(rows).T


def test_without_effects_it_is_the_law():
    done = simulated(nested(2e-3))
    table = build_tables(Sheath.uniform(K, LENGTH, EA))
    T_out, e = simulate_tensions(table, build_slack_profile(table), done.proximal_tension)
    full = done.proximal_tension.max()
    assert full > 15.0
    assert np.abs(T_out - done.distal_tension).max() < 2e-4 * full
    assert np.abs(e - done.proximal_displacement).max() < 1e-3 * e.max()
    assert np.abs(done.proximal_displacement - nested(2e-3)).max() < 1e-12


@pytest.mark.parametrize("effect", [{}, {"asymmetry": 0.7}, {"drag": 0.5}, {"creep": 0.1}])
def test_a_tension_drives_it_as_the_travel_did_that_made_it(effect):
    done = simulated(nested(2e-3), **effect)
    rate = np.gradient(done.proximal_tension, TIME)
    again = simulate_by_tension(physics(**effect), TIME, done.proximal_tension, rate)
    assert np.abs(again.distal_tension - done.distal_tension).max() < 1e-6
    assert np.abs(again.proximal_displacement - done.proximal_displacement).max() < 1e-9


@pytest.mark.parametrize("turns", [1, 2], ids=["in a release", "in a pull"])
@pytest.mark.parametrize("by", ["travel", "tension"])
def test_a_record_may_begin_in_the_midst_of_motion(by, turns):
    travel = nested(2e-3, least=0.45)
    T_in, T_out, _ = through(chain(), travel, [Position(0.0)] * len(travel))
    at = (np.flatnonzero(np.diff(np.sign(np.diff(travel)))) + 1)[:turns]
    begin = at[-1] + 15
    drive, run = {"travel": (travel, simulate_by_travel), "tension": (T_in, simulate_by_tension)}[
        by
    ]
    rest, time = drive[begin:], TIME[begin:]
    slow = np.zeros_like(rest)
    done = run(physics(earlier_turns=drive[at] - rest[0]), time, rest, slow)
    assert np.abs(done.distal_tension - T_out[begin:]).max() < 0.002 * T_in.max()
    assert np.abs(done.proximal_tension - T_in[begin:]).max() < 0.006 * T_in.max()
    without = run(physics(), time, rest, slow)
    assert np.abs(without.distal_tension - T_out[begin:]).max() > 0.05 * T_in.max()


@pytest.mark.parametrize(
    ("effect", "beads"),
    [({}, {}), ({"drag": 0.6}, {"drag": 0.6}), ({"asymmetry": 0.7}, {"asymmetry": 0.7})],
)
@pytest.mark.parametrize("softness", [0.0, 4e-4])
def test_beads_agree(effect, beads, softness):
    travel = nested(2e-3 if softness == 0.0 else 5e-3, least=0.45)  # these beads know no slack
    tip = Position(0.0) if softness == 0.0 else Spring(1.0 / softness)
    T_in, T_out, q_d = through(chain(**beads), travel, [tip] * len(travel))
    done = simulated(travel, tip_compliance=softness, **effect)
    assert T_in.max() > 10.0
    assert np.abs(done.proximal_tension - T_in).max() < 0.006 * T_in.max()
    assert np.abs(done.distal_tension - T_out).max() < 0.002 * T_in.max()
    assert np.abs(done.distal_displacement - q_d).max() < 0.002 * max(q_d.max(), 1e-6)


def test_beads_agree_where_the_environment_moves_the_tip():
    moved = 4e-4 * np.interp(TIME, [2.5, 3.0, 4.5, 4.7], [0.0, -1.0, -1.0, 0.5])
    travel = 1.5e-3 * np.interp(TIME, [0.0, 1.0, 2.0, 3.5, 4.0], [0.0, 1.0, 0.8, 0.8, 1.0])
    T_in, T_out, _ = through(chain(), travel, [Position(float(z)) for z in moved])
    done = simulated(travel, tip_offset=moved)
    assert np.ptp(T_out[TIME > 2.5]) > 5.0
    assert np.abs(done.proximal_tension - T_in).max() < 0.006 * T_in.max()
    assert np.abs(done.distal_tension - T_out).max() < 0.006 * T_in.max()


def strands(T_in, softness):
    """Return q_p and T_out of chains of beads side by side, each of its own friction.

    Each carries its share of T_in, and pulls its share of the spring at the tip.
    """
    q_p, T_out = np.zeros_like(T_in), np.zeros_like(T_in)
    tip = Position(0.0) if softness == 0.0 else Spring(1.0 / softness)
    for threshold, share in SPECTRUM:
        beads = Chain(SECTIONS, 0.15 * threshold, EA, beads=120)
        for i, tension in enumerate(T_in):
            beads.move(Force(float(tension)), tip)
            q_p[i] += share * beads.travel[0]
            T_out[i] += share * beads.T_out
    return q_p, T_out


@pytest.mark.parametrize("softness", [0.0, 4e-4])
def test_strands_side_by_side_that_let_go_one_after_another_are_one_chain(softness):
    turns = [0.0, 12.0, 3.0, 11.0, 5.0, 9.0, 1.5, 13.0, 6.0]
    T_in = np.interp(TIME, np.linspace(0.0, TIME[-1], len(turns)), turns)
    q_p, T_out = strands(T_in, softness)
    spread = physics(spectrum=SPECTRUM, tip_compliance=softness)
    forced = simulate_by_tension(spread, TIME, T_in, 0.0 * TIME)
    driven = simulate_by_travel(spread, TIME, q_p - q_p[0], 0.0 * TIME)
    assert np.abs(forced.distal_tension - T_out).max() < 0.002 * T_in.max()
    assert np.abs(driven.distal_tension - T_out).max() < 0.004 * T_in.max()
    assert np.abs(driven.proximal_tension - T_in).max() < 0.01 * T_in.max()
    assert driven.distal_displacement == pytest.approx(softness * driven.distal_tension, abs=1e-12)
    plain = simulate_by_tension(physics(tip_compliance=softness), TIME, T_in, 0.0 * TIME)
    assert np.abs(plain.distal_tension - T_out).max() > 0.05 * T_in.max()


def test_a_fall_of_friction_relaxes_a_tendon_at_rest_and_a_rise_does_nothing():
    travel = np.minimum(TIME / 2.0, 1.0) * 2e-3
    friction = np.where(TIME < 4.0, K, 0.75 * K)
    fallen = simulate_by_travel(physics()._replace(friction=friction), TIME, travel, 0.0 * TIME)
    beads = chain()
    through(beads, travel[TIME < 4.0], [Position(0.0)] * int((TIME < 4.0).sum()))
    beads.limit_motor, beads.limit_tip = 0.75 * beads.limit_motor, 0.75 * beads.limit_tip
    beads.move(Position(float(travel[-1])), Position(0.0))
    assert fallen.proximal_tension[-1] == pytest.approx(beads.T_in, rel=2e-3)
    assert fallen.distal_tension[-1] == pytest.approx(beads.T_out, rel=2e-3)
    risen = simulate_by_travel(
        physics()._replace(friction=2 * K - friction), TIME, travel, 0.0 * TIME
    )
    resting = TIME > 2.1
    assert np.ptp(risen.proximal_tension[resting]) < 1e-9


@pytest.mark.parametrize(
    "effect",
    [
        {"viscosity": 500.0},
        {"stribeck": 0.3},
        {"stribeck": 0.3, "stribeck_memory": 0.2},
        {"static": 0.3},
        {"exponent": 0.85},
        {"rise": 0.01},
        {"presliding": 3e-5},
        {"presliding": 3e-5, "presliding_tension": 10.0},
        {"spectrum": SPECTRUM},
        {"toe": 1e-4},
        {"compression": 1e-6, "threshold": 3.0},
        {"load_low": -0.4, "load_high": 0.4},
        {"mass": 0.3, "damping": 20.0},
    ],
)
def test_whatever_it_does_the_motor_is_where_it_is_and_a_slack_tendon_pulls_nothing(effect):
    travel = nested(5e-3) - 3e-4
    done = simulated(travel, tip_compliance=4e-4, **effect)
    taut = done.proximal_tension > 0.0
    assert np.abs(done.proximal_displacement - travel)[taut].max() < 1e-8
    assert (done.proximal_tension >= 0.0).all()
    assert (done.distal_tension >= 0.0).all()
    assert (done.proximal_tension[travel < -1e-4] < 1e-6).all()
    plain = simulated(travel, tip_compliance=4e-4)
    assert np.std(done.proximal_tension - plain.proximal_tension) > 0.005


@pytest.mark.parametrize("effect", [{}, {"asymmetry": 1.3}, {"creep": 0.1}, {"mass": 0.3}])
def test_what_a_step_keeps_for_the_next_changes_no_bit(effect):
    driven = physics(tip_compliance=4e-4, **effect)
    travel = nested(5e-3) - 3e-4
    at_once = DrivenTendon(driven, TIME).drive_by_travel(travel, 0)
    tendon = DrivenTendon(driven, TIME)
    one_by_one = [tendon.drive_by_travel(travel[: i + 1], i)[0] for i in range(len(TIME))]
    np.testing.assert_array_equal(one_by_one, at_once)


@pytest.mark.parametrize("seed", [5001, 5004])
def test_a_tip_that_meets_a_stop_is_that_of_a_chain_of_beads(seed):
    made = hidden_effects.make(seed, "tip_contact", bench="spring", duration=20.0, rate=50.0)
    sheath, stop = made.truth["sheath"], made.truth["tip_contact"]
    tendon = Physics(
        np.array([sheath["K"]]),
        sheath["L"] / sheath["EA"],
        build_even_weights(),
        tip_compliance=1.0 / sheath["k"],
    )
    contact = {"contact": stop["travel"], "contact_stiffness": stop["stiffness"]}
    travel = made.channels["proximal_displacement"]
    speed = np.gradient(travel, made.time)

    def miss(**changes):
        done = simulate_by_travel(tendon._replace(**changes), made.time, travel, speed)
        return float(np.std(done.proximal_tension - made.channels["proximal_tension"]))

    assert miss(**contact) < 0.03  # of which 0.02 are noise
    assert miss() > 1.0
