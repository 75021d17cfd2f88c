"""A model with a free function in the loop, on data by a chain of beads."""

import math
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from estimator.diagnosis.dataset import Model
from estimator.diagnosis.validation import transfer_to_validation
from estimator.effects.functions import compute_basis, find_function
from estimator.lumped.lumped_model import Physics
from estimator.online import dynamic_correction, online
from estimator.online.dynamic_correction import FunctionConstants, FunctionState, FunctionVariable
from estimator.online.extended_model import EffectUse, build_extended_model, explain_omission
from estimator.online.tendon_estimate import TIP_MOVED
from estimator.online.tendon_model import TendonModel
from studies import hidden_effects

NOISE, STEP, SECONDS = 0.02, 1.2e-7, 20.0
HIDDEN = {
    "friction_by_position": "outside:friction_over_position",
    "proximal_tension_by_reading": "outside:curved_reading",
}


@cache
def make(seed, effects=()):
    return hidden_effects.make(seed, effects, duration=SECONDS, rate=100.0)


def fitted(name, x, f):
    """Return an effect with the function that is nearest to `f` at `x`."""
    effect = find_function(name)
    shapes = (float(x.min()), float(x.max()))
    basis = compute_basis(effect, (*shapes, *((len(effect.parameters) - 2) * [0.0])), x)
    return effect, (*shapes, *np.linalg.lstsq(basis, f, rcond=None)[0].tolist())


def built(data, pair):
    sheath = data.truth["sheath"]
    K, L, EA = (sheath[key] for key in ("K", "L", "EA"))
    compliance = 1.0 / sheath["k"] if sheath["k"] else 0.0
    found = build_extended_model((K, L / EA, compliance), [pair] if pair else [], SECONDS, L)
    noise = {"tension_noise": NOISE, "displacement_noise": STEP / math.sqrt(12.0)}
    return TendonModel(found.sheath, extension=found.extension, **noise), found


def estimated(model, data):
    tension, travel = (data.channels[f"proximal_{one}"] for one in ("tension", "displacement"))
    return online.run(online.prepare(model), data.time, tension, travel)


def rms_error(model, data):
    off = estimated(model, data).distal_tension - data.channels["distal_tension"]
    return float(np.sqrt(np.mean(off**2)))


@pytest.mark.parametrize(("name", "seed"), list(zip(HIDDEN, (2, 4), strict=True)))
def test_the_force_is_right_with_the_function_and_inside_its_interval(name, seed):
    data = make(seed, HIDDEN[name])
    truth = {key: value for key, value in data.truth[HIDDEN[name]].items() if key != "channel"}
    channel = "proximal_displacement" if "position" in name else "proximal_tension"
    x = data.channels[channel]
    share = (x - x.min()) / np.ptp(x) if "position" in name else x / x.max()
    pair = fitted(name, x, hidden_effects.free_curves.evaluate_curve(**truth, share=share))
    more, _ = built(data, pair)
    assert rms_error(more, data) < 0.5 * rms_error(built(data, None)[0], data)
    found, tip = estimated(more, data), data.channels["distal_tension"]
    assert np.mean((found.low - 4 * NOISE <= tip) & (tip <= found.high + 4 * NOISE)) > 0.97


@pytest.mark.parametrize(("seed", "bench"), [(515, "blocked"), (603, "spring")])
def test_tension_that_falls_behind_a_rough_spot_is_no_motion_of_the_tip(seed, bench):
    how = {"duration": 30.0, "rate": 50.0, "travel_noise": 5e-7}
    data = hidden_effects.make(seed, "outside:rough_spot", bench=bench, **how)
    x = data.channels["proximal_displacement"]
    more, _ = built(data, fitted("friction_by_position", x, data.friction - 1.0))
    assert not (estimated(more, data).status & TIP_MOVED).any()
    assert rms_error(more, data) < 0.5 * rms_error(built(data, None)[0], data)


def test_beyond_the_range_that_was_seen_the_interval_is_wider():
    data = make(2, HIDDEN["friction_by_position"])
    x = data.channels["proximal_displacement"]
    f = 0.3 * np.sin(6.0 * (x - x.min()) / np.ptp(x))
    effect, values = fitted("friction_by_position", x, f)
    wide, narrow = (
        estimated(built(data, (effect, (values[0], end, *values[2:])))[0], data)
        for end in (values[1], 0.5 * (values[0] + values[1]))
    )
    beyond = (x > 0.6 * (values[0] + values[1])) & (wide.distal_tension > 1.0)
    assert beyond.any()
    width = [np.mean((one.high - one.low)[beyond]) for one in (wide, narrow)]
    assert width[1] > 1.2 * width[0]


def test_a_function_changes_the_force_by_no_more_than_its_friction_can():
    x = np.linspace(0.0, 10.0, 50)
    data = make(2)
    model, _ = built(data, fitted("friction_by_position", x, 0.3 * np.sin(x)))
    K, dynamics = data.truth["sheath"]["K"], model.extension.dynamics
    peak = dynamics.function.peak
    assert peak == pytest.approx(0.3, abs=0.05)
    for T_out, side in ((93.0, 1.0), (1e-3, -1.0)):
        bounded = dynamic_correction.bound_tip_tension(dynamics, 4.0, T_out)
        assert bounded == pytest.approx(4.0 * math.exp(side * K * peak))


def test_what_the_loop_cannot_follow_is_left_out_with_the_reason():
    x = np.linspace(0.0, 10.0, 50)
    data = make(2)
    uses = {
        name: built(data, fitted(name, x, 0.1 + 0.0 * x))[1].uses[0][2]
        for name in ("friction_by_time", "friction_by_rest_time", "tip_load_by_time")
    }
    assert list(uses.values()) == [EffectUse.LAW, EffectUse.DYNAMICS, EffectUse.OMITTED]
    assert "follows time" in explain_omission(find_function("tip_load_by_time"))


def test_friction_that_the_loop_cannot_follow_leaves_its_mean():
    warmth = np.linspace(20.0, 30.0, 50)
    warm = fitted("friction_by_temperature", warmth, 0.03 * (warmth - 20.0))
    cycle = (find_function("friction_by_phase"), (4.0, *np.tile([0.3, -0.1], 6).tolist()))
    for pair, mean in ((warm, 0.15), (cycle, 0.1)):
        found = build_extended_model((0.8, 1e-4, 0.0), [pair], 10.0, 1.0)
        assert found.uses[0][2] is EffectUse.OMITTED
        np.testing.assert_allclose(found.sheath.K, 0.8 * (1.0 + mean), rtol=1e-3)
        assert "K has its mean" in explain_omission(pair[0])
    dataset = SimpleNamespace(records=[SimpleNamespace(time=warmth)])
    ((on_other_days, values),) = transfer_to_validation(dataset, Model((), (), (cycle,))).effects
    other_day = on_other_days.physics(Physics(np.full(7, 0.8), 1e-4, np.ones(1)), values, None)
    np.testing.assert_allclose(other_day.friction, 0.8 * 1.1, rtol=1e-3)


@pytest.mark.parametrize("name", ["friction_by_time", "friction_by_path"])
def test_validation_and_loop_take_friction_as_a_record_ended(name):
    x = np.linspace(0.0, 10.0, 50)
    effect, values = fitted(name, x, 0.03 * x)
    dataset = SimpleNamespace(records=[SimpleNamespace(time=x)])
    model = transfer_to_validation(dataset, Model((0.8,), (), ((effect, values),)))
    ((frozen, _),) = model.effects
    other_day = frozen.physics(Physics(np.full(7, 0.8), 1e-4, np.ones(1)), values, None)
    np.testing.assert_allclose(other_day.friction, 0.8 * 1.3, rtol=1e-3)
    loop_friction = build_extended_model((0.8, 1e-4, 0.0), [(effect, values)], 10.0, 1.0).sheath.K
    assert loop_friction == pytest.approx(other_day.friction[0])


def test_a_rest_is_one_while_the_encoder_is_noisy():
    time = np.arange(0.0, 6.0, 0.001)
    noise = 1e-6 * np.random.default_rng(0).standard_normal(len(time))
    constants = FunctionConstants.new(variable=int(FunctionVariable.REST_TIME), high=10.0)
    state = FunctionState.new()
    for q in 0.01 * np.minimum(time, 1.0) + noise:
        dynamic_correction.update_function(constants, state, 5.0, q, 0.001)
    assert state.rest_time == pytest.approx(5.0, abs=0.2)


@pytest.mark.parametrize("dt", [0.001, 0.02])
def test_a_steady_speed_is_itself_at_any_rate(dt):
    constants = FunctionConstants.new(variable=int(FunctionVariable.SPEED), low=-1.0, high=1.0)
    state = FunctionState.new()
    for q in 0.01 * np.arange(0.0, 1.0, dt):
        dynamic_correction.update_function(constants, state, 5.0, q, dt)
    assert state.speed == pytest.approx(0.01, rel=1e-6)
