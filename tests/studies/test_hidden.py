"""The makers of hidden effects obey mechanics, and hide what they say."""

from itertools import pairwise

import numpy as np
import pytest

from studies.hidden_effects import CHANNELS, VISIBLE, make, motion
from studies.hidden_effects.chain import (
    SPRUNG,
    Law,
    Tip,
    build_line,
    build_resting_state,
    run,
    step,
)
from studies.hidden_effects.session import JUST_SEEN, compute_visibility, draw_bench

QUICK = {"duration": 30.0, "rate": 20.0}
EXACT = {"noise": 0.0, "resolution": 0.0}
K, L, EA = 1.1, 1.5, 9e3
TIPS = [Tip(), Tip(SPRUNG, stiffness=2000.0)]
QUICK_PLACES = {"friction_step": "spring", "creep": "blocked", "encoder_slip": "spring"}
PLACES = [
    pytest.param(name, at, marks=[] if QUICK_PLACES.get(name) == at else pytest.mark.slow)
    for name, benches in VISIBLE.items()
    for at in benches
]


def conditions(motor):
    zero = np.zeros(len(motor))
    return np.column_stack([motor, zero, zero + 1.0, zero])


def wandering(tip, count, seed=4):
    """A motor that swings, turns back early and goes slack."""
    rng = np.random.default_rng(seed)
    far = 8e-3 if tip.kind == SPRUNG else 2e-3
    ends = far * np.array([0, 1, 0.1, 0.9, 0.5, 0.7, 0.6, -0.1, 0.8, 0, *rng.uniform(0, 1, 4)])
    return np.interp(np.linspace(0, len(ends) - 1, count), np.arange(len(ends)), ends)


@pytest.mark.parametrize("tip", TIPS)
def test_every_node_is_in_balance_and_every_bead_obeys_coulomb(tip):
    line = build_line([(L / 3, K / 2), (2 * L / 3, K / 2)], 1.0, EA, beads=40)
    state = build_resting_state(line, Law(), tip)
    outside = conditions(wandering(tip, 300))
    slid = set()
    for before, after in pairwise(outside):
        x = state.x.copy()
        step(line, Law(), tip, state, before, after, 0.01)
        T = np.maximum(EA * (state.x[:-1] - state.x[1:]) / line.length, 0.0)
        jump, moved = T[:-1] - T[1:], (state.x - x)[1:-1]
        limit = line.friction[1:-1] * (T[:-1] + T[1:]) / 2
        assert np.abs(state.tension - T).max() < 1e-6
        assert state.x[0] == pytest.approx(after[0], abs=1e-12)
        assert np.all(np.abs(jump) <= limit + 1e-6)
        slides = np.abs(moved) > 1e-9
        taut = slides & (limit > 1e-6)
        np.testing.assert_allclose(jump[taut], np.sign(moved[taut]) * limit[taut], atol=1e-6)
        assert T[-1] == pytest.approx(tip.stiffness * state.x[-1], abs=1e-6) or tip.kind != SPRUNG
        slid |= set(np.sign(moved[taut]))
    assert slid == {-1.0, 1.0}


@pytest.mark.slow
@pytest.mark.parametrize("bench", ["blocked", "spring"])
def test_more_beads_change_less_than_two_millinewtons(bench):
    there, clean, _, _ = draw_bench(3, bench, **QUICK)
    tensions = {}
    for beads in (30, 60, 120, 360):
        line = build_line(clean.sections, 1.0, there.EA, beads=beads)
        state = build_resting_state(line, Law(), there.tip)
        motor = motion.trace_motor(there.ways, there.time, state.x[0], 0.0)
        out = run(line, Law(), there.tip, state, conditions(motor), there.time[1], 1)
        tensions[beads] = out[:, [0, 2]]
    errors = [np.abs(tensions[beads] - tensions[360]).max() for beads in (30, 60, 120)]
    assert errors[2] < 2e-3
    assert errors[0] > 3 * errors[1] > 9 * errors[2]


@pytest.mark.parametrize(("name", "bench"), PLACES)
def test_an_effect_shows_at_full_size_and_is_gone_without(name, bench):
    clean = make(1, (), bench=bench, **QUICK, **EXACT)
    full = make(1, name, bench=bench, **QUICK, **EXACT)
    none = make(1, name, size=0.0, bench=bench, **QUICK, **EXACT)
    assert compute_visibility(full.channels, clean.channels) > 5.0
    for channel in CHANNELS:
        np.testing.assert_allclose(
            none.channels[channel],
            clean.channels[channel],
            atol=1e-3 * JUST_SEEN[channel.split("_")[1]],
        )
    assert np.diff(full.heat).min() > -1e-12
    assert full.heat[-1] > 0.0
