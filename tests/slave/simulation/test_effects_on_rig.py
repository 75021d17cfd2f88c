from dataclasses import replace
from typing import get_args, get_type_hints

import numpy as np
import pytest

from slave.rigs.simulated import JointConfig, SimulatedRig, SimulatedRigConfig, TendonPlantConfig
from slave.simulation.effects import EffectConfig
from slave.simulation.environment import FreeConfig, TissueConfig
from slave.simulation.joint import BodyConfig
from slave.simulation.sensor_models import CHANNELS, EncoderConfig, LoadCellConfig
from teleop.config.loading import load
from teleop.errors import UsageError

QUIET = TendonPlantConfig(load_cell=LoadCellConfig(0.0, 0.0), encoder=EncoderConfig(0))
SINGLE = JointConfig((QUIET,), BodyConfig(), TissueConfig())
PAIR = JointConfig((QUIET, QUIET), BodyConfig(pretension=2.0), FreeConfig())

T_IN, Q_IN, T_OUT, Q_OUT = CHANNELS  # proximal tension and displacement, distal ones

# Name: where it is seen. Every channel named must change; a cause in a sensor changes no other.
PHYSICS = {
    "friction_step": {T_OUT, T_IN},
    "friction_drift": {T_OUT, T_IN},
    "constant_drag": {T_OUT, T_IN},
    "tension_dependent_friction": {T_OUT, T_IN},
    "viscous_friction": {T_OUT, T_IN},
    "stribeck_friction": {T_OUT, T_IN},
    "presliding": {T_OUT, T_IN},
    "stick_slip": {T_OUT, T_IN},
    "direction_asymmetry": {T_OUT, T_IN},
    "nonlinear_stiffness": {T_IN},
    "sheath_compression": {T_IN},
    "slack": {T_IN},
    "creep": {T_IN},
    "thermal_expansion": {T_IN},
    "nonuniform_curvature": {T_IN},
    "pretension": {T_IN, T_OUT},
    "joint_backlash": {Q_OUT},
    "joint_friction": {Q_OUT, T_OUT},
    "tip_inertia": {Q_OUT, T_OUT},
    "tip_moved": {Q_OUT, T_OUT},
    "pulley_eccentricity": {T_IN, Q_OUT},
    "broken_tendon": {T_IN, T_OUT},
    "jammed_tendon": {T_OUT, Q_OUT},
    "antagonist_tension": {T_IN, T_OUT, Q_OUT},
}
SENSORS = {
    "proximal_tension_gain": T_IN,
    "proximal_tension_bias": T_IN,
    "proximal_tension_drift": T_IN,
    "distal_tension_gain": T_OUT,
    "distal_tension_bias": T_OUT,
    "distal_tension_drift": T_OUT,
    "saturation": T_IN,
    "sensor_lag": T_IN,
    "encoder_scale": Q_IN,
    "encoder_slip": Q_IN,
    "cogging_ripple": T_IN,
    "sheath_rub": T_IN,
    "stuck_cell": T_IN,
}
SAMPLES = {"lost_samples", "repeated_samples"}
NEEDED = {
    "friction_drift": {"per_second": 0.3},
    "thermal_expansion": {"time_constant": 0.5},
    "creep": {"share": 0.3, "time_constant": 0.5},
    "proximal_tension_drift": {"per_second": 0.05},
    "distal_tension_drift": {"per_second": 0.05},
}
VISIBLE = {T_IN: 0.02, Q_IN: 2e-5, T_OUT: 0.02, Q_OUT: 2e-5}  # [N], [m]: more than a sensor's noise

BY_NAME = {get_args(get_type_hints(c)["type"])[0]: c for c in get_args(EffectConfig)}


def made(name, **changes):
    return BY_NAME[name](**NEEDED.get(name, {}) | changes)


def run(joint, *effects, seconds=1.2, stroke=0.012, path=lambda q: q):
    """Move tendon a of a rig by a sine, b against it; return its channels."""
    rig = SimulatedRig(SimulatedRigConfig(joints=(joint,), effects=effects))
    rows = {name: [] for name in ("time_s", *CHANNELS)}
    for k in range(round(seconds * 1000)):
        for sample in rig.read(k * 1e-3):
            rows["time_s"].append(sample.time_s)
            rows[T_IN].append(sample.proximal_tension)
            rows[Q_IN].append(sample.proximal_displacement)
            rows[T_OUT].append(sample.bench_distal_tension)
            rows[Q_OUT].append(sample.bench_distal_displacement)
        target = path(0.5 * stroke * (1.0 - np.cos(2.0 * np.pi * k * 1e-3)))
        rig.write(np.array([target, -target][: rig.tendons]))
    return {name: np.array(values) for name, values in rows.items()}


@pytest.fixture(scope="module")
def healthy():
    return {joint: run(joint) for joint in (SINGLE, PAIR)}


def seen(run_with, run_without):
    return {c for c in CHANNELS if np.abs(run_with[c] - run_without[c]).max() > VISIBLE[c]}


def test_every_effect_that_has_a_name_can_be_switched_on():
    assert set(BY_NAME) == {*PHYSICS, *SENSORS, *SAMPLES}


@pytest.mark.parametrize("name", PHYSICS)
def test_an_effect_in_the_physics_is_seen_where_it_acts(name, healthy):
    joint = PAIR if name == "antagonist_tension" else SINGLE
    assert seen(run(joint, made(name)), healthy[joint]) >= PHYSICS[name]


@pytest.mark.parametrize("name", SENSORS)
def test_an_effect_in_a_sensor_is_seen_there_and_nowhere_else(name, healthy):
    with_effect = run(SINGLE, made(name))
    assert seen(with_effect, healthy[SINGLE]) == {SENSORS[name]}
    for channel in set(CHANNELS) - {SENSORS[name]}:
        assert np.array_equal(with_effect[channel], healthy[SINGLE][channel])


@pytest.mark.parametrize(
    "name", ["friction_step", "creep", "tip_moved", "encoder_slip", "broken_tendon", "sheath_rub"]
)
def test_nothing_is_seen_of_an_effect_before_it_starts(name, healthy):
    late = run(SINGLE, made(name, start=0.4))
    before = healthy[SINGLE]["time_s"] < 0.4 - 1e-9
    for channel in CHANNELS:
        assert np.array_equal(late[channel][before], healthy[SINGLE][channel][before])
    assert seen(late, healthy[SINGLE])


def test_an_effect_stays_in_its_joint_and_its_tendon():
    two = SimulatedRigConfig(joints=(PAIR, PAIR))

    def readings(*effects):
        rig = SimulatedRig(replace(two, effects=effects))
        return rig.read(0.1)[0].proximal_tension - 2.0

    assert np.abs(readings(made("proximal_tension_bias", joint=2, tendon="b"))) == pytest.approx(
        [0, 0, 0, 0.4], abs=1e-3
    )
    assert np.abs(readings(made("proximal_tension_bias", tendon="a"))) == pytest.approx(
        [0.4, 0, 0.4, 0], abs=1e-3
    )
    assert np.abs(readings(made("slack", joint=1))) == pytest.approx([2, 2, 0, 0], abs=1e-3)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("proximal_tension_gain", lambda reading: 1.06 * reading),
        ("distal_tension_bias", lambda reading: reading + 0.4),
        ("encoder_scale", lambda reading: 1.04 * reading),
        ("encoder_slip", lambda reading: reading + 8e-5),
    ],
)
def test_a_sensor_reads_too_much_by_what_is_said_from_its_start_on(name, expected, healthy):
    rows, channel = run(SINGLE, made(name, start=0.5)), SENSORS[name]
    after = rows["time_s"] > 0.5 - 1e-9
    reading = healthy[SINGLE][channel]
    assert rows[channel][after] == pytest.approx(expected(reading[after]), rel=1e-9, abs=1e-12)
    assert np.array_equal(rows[channel][~after], reading[~after])


@pytest.mark.parametrize(
    ("sensor", "channel"), [("proximal_displacement", Q_IN), ("distal_displacement", Q_OUT)]
)
def test_a_late_sensor_comes_nearer_by_63_percent_in_its_time_constant(sensor, channel):
    def step(*effects):
        return run(SINGLE, *effects, seconds=1.0, path=lambda _: 5e-3)[channel][:, 0]

    behind = step() - step(made("sensor_lag", time_constant=0.06, sensor=sensor))
    assert behind[360] / behind[300] == pytest.approx(np.exp(-1.0), rel=0.01)
    assert behind.sum() * 1e-3 == pytest.approx(0.06 * step()[-1], rel=0.02)


def test_a_pretension_is_added_to_that_of_the_body_and_moves_nothing():
    joint = PAIR
    rows = run(joint, made("pretension", tension=3.0), stroke=0.0, seconds=0.3)
    for channel in (T_IN, T_OUT):
        assert rows[channel] == pytest.approx(joint.body.pretension + 3.0, abs=1e-9)
    assert np.abs(rows[Q_OUT]).max() < 1e-9


def test_a_sheath_bent_more_at_its_tip_stretches_its_tendon_as_its_tensions_say():
    """Curvature grows by equal ratios along x; de = T dx/EA, dT = -mu T ds/R: summed up."""
    ratio = 4.5
    held = JointConfig((QUIET,), BodyConfig(pretension=0.2, friction=100.0), FreeConfig())
    rows = run(held, made("nonuniform_curvature", ratio=ratio), stroke=3e-3, seconds=0.5)
    n = 4000
    curvature = ratio ** ((np.arange(n) + 0.5) / n)
    bend = 0.15 * 1.5 / 0.225 * curvature / curvature.sum()
    share = np.cumprod(1.0 - bend)  # of the tension at the housing
    elongation = rows[Q_IN][-1] + 0.2 * 1.5 / 9000.0
    assert rows[T_IN][-1] == pytest.approx(elongation * 9000.0 / 1.5 / share.mean(), rel=0.01)
    assert rows[T_OUT][-1] / rows[T_IN][-1] == pytest.approx(share[-1], rel=0.01)


def test_ripple_and_eccentricity_go_with_the_pulleys_angle(healthy):
    rows = run(SINGLE, made("cogging_ripple", amplitude=0.2, order=30.0, phase=0.5))
    angle = rows[Q_IN][:, 0] / 0.010
    felt = rows[T_IN][:, 0] - healthy[SINGLE][T_IN][:, 0]
    assert felt == pytest.approx(0.2 * np.sin(30.0 * angle + 0.5), abs=1e-9)
    wobble = run(SINGLE, made("pulley_eccentricity", amplitude=2e-4, phase=0.3))
    assert wobble[Q_IN] == pytest.approx(healthy[SINGLE][Q_IN], abs=1e-6)
    off_centre = run(SINGLE, path=lambda q: q + 2e-4 * (np.sin(q / 0.010 + 0.3) - np.sin(0.3)))
    assert wobble[T_IN] == pytest.approx(off_centre[T_IN], abs=0.05)
    assert seen(off_centre, healthy[SINGLE]) >= {T_IN, Q_OUT}


def test_the_hand_that_moves_the_tip_takes_it_where_it_says_and_lets_go():
    still = JointConfig((QUIET,), BodyConfig(), FreeConfig())
    hand = made("tip_moved", start=0.5, travel=-2e-3, speed=0.02, hold=0.3, stiffness=1e6)
    rows = run(still, hand, stroke=0.0, seconds=1.5)
    travel, time = rows[Q_OUT][:, 0], rows["time_s"]
    assert np.abs(travel[time < 0.5 - 1e-9]).max() < 1e-9
    assert travel[np.searchsorted(time, 0.65)] == pytest.approx(-2e-3, rel=0.02)
    assert np.abs(travel[time > 1.2]).max() < 5e-4

    away = run(still, hand, seconds=1.5, path=lambda _: 5e-3)
    travel = away[Q_OUT][:, 0]
    begin = travel[np.searchsorted(time, 0.499)]
    assert begin > 3e-3
    assert travel[np.searchsorted(time, 0.65)] == pytest.approx(begin - 2e-3, abs=5e-5)


def test_lost_samples_are_missing_and_repeated_ones_stale(healthy):
    burst = 4.0
    lost = run(SINGLE, made("lost_samples", share=0.2, burst=burst))
    gone = 1.0 - len(lost["time_s"]) / 1200
    assert 0.12 < gone < 0.28
    gaps = np.diff(lost["time_s"]) * 1000
    assert gaps[gaps > 1.5].mean() - 1.0 == pytest.approx(burst, rel=0.35)
    kept = np.isin(healthy[SINGLE]["time_s"].round(6), lost["time_s"].round(6))
    assert np.array_equal(lost[T_IN], healthy[SINGLE][T_IN][kept])

    again = run(SINGLE, made("repeated_samples", share=0.2, burst=burst))
    assert np.array_equal(again["time_s"], healthy[SINGLE]["time_s"])
    same = again[T_IN][:, 0] == healthy[SINGLE][T_IN][:, 0]
    assert 0.12 < 1.0 - same.mean() < 0.28
    stale = np.flatnonzero(~same)
    assert np.array_equal(again[T_IN][stale], again[T_IN][stale - 1])


def test_all_effects_can_be_written_in_a_config_file(tmp_path):
    lines = "".join(f"    - {{type: {name}, joint: 1, start: 0.0}}\n" for name in BY_NAME)
    lines = lines.replace("friction_drift,", "friction_drift, per_second: 0.01,")
    file = tmp_path / "rig.yaml"
    file.write_text(f"slave:\n  joints: [{{tendons: [{{}}, {{}}]}}]\n  effects:\n{lines}")
    config = load(file, SimulatedRigConfig, "slave")
    assert [effect.type for effect in config.effects] == list(BY_NAME)
    SimulatedRig(config).read(0.01)


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        ("{type: joint_friction, joint: 3}", r"effects\.0\.joint: 3: must be 1 to 2"),
        ("{type: slack, joint: 1, tendon: b}", r"effects\.0\.tendon: .*no joint has a tendon b"),
        ("{type: antagonist_tension, joint: 1}", r"effects\.0\.joint: .*must have two tendons"),
        (
            "{type: creep}, {type: creep, joint: 2, tendon: b}",
            r"two of type creep cannot be combined",
        ),
        ("{type: lost_samples, share: 0.6}", r"share: 0\.6: must be at most 0\.5 in bursts of 1"),
        ("{type: friction_drift}", r"effects\.0\.per_second: 0\.0: set this or per_metre"),
        ("{type: pretension, start: 1}", r"effects\.0\.start: 1.0: must be 0 s"),
        ("{type: joint_frictoin}", r"did you mean 'joint_friction'"),
    ],
)
def test_an_effect_that_cannot_be_is_refused_in_one_line(effect, message, tmp_path):
    file = tmp_path / "rig.yaml"
    file.write_text(f"slave:\n  joints: [{{}}, {{tendons: [{{}}, {{}}]}}]\n  effects: [{effect}]\n")
    with pytest.raises(UsageError, match=message) as refused:
        load(file, SimulatedRigConfig, "slave")
    assert "\n" not in str(refused.value)


ONE_ALONE = {name for name, effect in BY_NAME.items() if not effect.adds_up}


@pytest.mark.parametrize("name", sorted(ONE_ALONE))
def test_two_that_would_act_as_one_are_refused_on_the_same_tendon(name):
    refused = rf"effects\[1\]: .*two of type {name} cannot be combined"
    with pytest.raises(ValueError, match=refused):
        SimulatedRigConfig(joints=(PAIR,), effects=(made(name, tendon="a"), made(name)))
    apart = made(name, tendon="a"), made(name, tendon="b"), made("slack")
    assert SimulatedRigConfig(joints=(PAIR,), effects=apart).effects == apart
