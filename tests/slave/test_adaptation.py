"""Adaptation of K in the slave: which tendons, undone with a tick, refusals, and the monitor."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from estimator.law import tables
from estimator.structs import as_bytes
from slave import loop
from slave.adaptation import UNDECIDED_S, AdaptationConfig, describe_fixed
from slave.config import SlaveConfig, to_tendon_config
from slave.extensions import EstimatorExtension
from slave.rig import RigSample
from slave.rigs.replayed_data import ReplayedRigConfig
from slave.rigs.simulated import JointConfig, SimulatedRig, SimulatedRigConfig, TendonPlantConfig
from slave.samples import estimate, to_sample_rows
from slave.simulation.effects.friction import FrictionStep
from slave.simulation.sensing_loop import SensingLoopConfig
from slave.simulation.tendon import SheathConfig
from slave.tendon_config import TendonConfig
from teleop.config.arm import ArmConfig
from teleop.data.standard_columns import Columns
from teleop.errors import UsageError
from teleop.session.tick_checkpoint import Checkpoint

JOINTS = ((0, 1), (2,))  # a pair, and a tendon against a spring
TENDON = TendonConfig(effective_friction=0.8, tension_noise=0.02, displacement_noise=1e-6)
ON = AdaptationConfig(enabled=True)


def started(config=ON, second=TENDON):
    model = loop.build_rig_model(
        JOINTS, [TENDON.build_model(), second.build_model(), TENDON.build_model()]
    )
    return loop.init_slave(model, SlaveConfig(adaptation=config), loop.DIRECT, starts_at_zero=True)


def pulls(begin_s, end_s):
    """Return samples of pulls and releases of all tendons, of which the tip travels with them."""
    t = np.arange(begin_s, end_s, 0.002)
    T = 1.0 + 6.5 * (1.0 - np.cos(2.0 * np.pi * t))
    travel = 3e-4 * (T - 1.0)
    return to_sample_rows(
        [
            RigSample(*row)
            for row in zip(t, *(np.tile(row, (3, 1)).T for row in (T, travel)), strict=True)
        ]
    )


def run(slave, rows):
    estimate(*slave.estimate_arguments, rows, len(rows))


def clone(rows):
    """Return a copy that has the bytes between the fields, too."""
    copy = np.empty_like(rows)
    as_bytes(copy)[:] = as_bytes(rows)
    return copy


def snapshot(slave):
    kept = slave.memory, slave.estimators, slave.prepared, slave.adapter.states, slave.adapter.pairs
    return [as_bytes(records).copy() for records in kept]


def test_tendons_of_a_pair_adapt_together_and_a_single_one_by_itself():
    slave = started()
    run(slave, pulls(0.0, 2.0))
    assert slave.adapter.states["pieces"][2] > 10
    assert slave.adapter.states["pieces"].tolist()[:2] == [0, 0]
    assert slave.adapter.pairs["started"].tolist() == [True, False]
    assert (slave.prepared["K_below"] + slave.prepared["K_above"] > 0.0).all()
    assert slave.adapter.get_friction(1).tobytes() == slave.adapter.pairs[0]["b"].tobytes()
    models = [TENDON.build_model()] * 4 + [TendonConfig(effective_friction=0.05).build_model()]
    (line,) = describe_fixed(ON, ((0,), (1, 2), (3, 4)), models)
    assert line.startswith("slave.adaptation: K stays as calibrated at joint 3: ")
    assert describe_fixed(ON, ((0,), (1, 2)), models) == []


def test_what_a_tick_has_adapted_is_undone_with_it():
    slave, rows = started(), pulls(2.0, 3.0)
    run(slave, pulls(0.0, 2.0))
    checkpoint = Checkpoint(*slave.restorable_arrays)
    before = snapshot(slave)
    run(slave, clone(rows))
    once = snapshot(slave)
    checkpoint.restore()
    assert all(map(np.array_equal, before, snapshot(slave)))
    run(slave, clone(rows))
    assert all(map(np.array_equal, once, snapshot(slave)))
    assert not any(map(np.array_equal, before, once))


def test_the_monitor_is_heard_where_the_adaptation_cannot_decide():
    slave = started()

    def left(K, *evidence_ages):
        slave.memory["monitors"]["count"] = 5
        for i, age in enumerate(evidence_ages):
            slave.adapter.get_friction(i)["evidence_age"] = age
        slave.prepared["tables"][:, tables.K] = K
        loop.monitor_calibration(*slave.monitor_arguments, pulls(0.0, 0.01), 0)
        return slave.memory["monitors"]["count"][0, :3].tolist()

    long = UNDECIDED_S + 1.0  # no piece fitted
    assert left(0.8, 1.0, 1.0, 1.0) == [0, 0, 0]
    assert left(0.8, long, 1.0, long) == [5, 0, 5]
    assert left(0.8, 1.0, long, 1.0) == [0, 5, 0]
    assert left(1.8 * 0.8, 1.0, 1.0, 1.0) == [5, 5, 5]  # the largest K that it considers
    slave.memory["degradation"]["active"] = True
    assert left(0.8, 1.0, 1.0, 1.0) == [5, 5, 5]
    for i, low in enumerate((0.7, 0.85, 0.6)):
        friction = slave.adapter.get_friction(i)
        friction["low"], friction["high"] = low, 0.9
    assert left(0.8, 1.0, 1.0, 1.0) == [0, 5, 5]  # the second is not in use yet, the third wide
    slave.adapter.get_friction(0)["doubt"] = 1.0
    assert left(0.8, 1.0, 1.0, 1.0) == [5, 5, 5]
    slave = started(second=TendonConfig(effective_friction=0.05))  # a pair with nothing to adapt
    assert left(0.8, 1.0, 1.0, 1.0) == [5, 5, 0]


def test_a_lost_sample_of_one_tendon_does_not_make_the_estimate_of_the_other_jump():
    slave = started()
    run(slave, pulls(0.0, 2.0))
    rows = pulls(2.0, 2.3)  # a turn, after which the tip follows late
    rows["tendons"]["tension"][4, 1] = np.nan
    run(slave, rows)
    T_out = rows["tendons"]["estimate"]["distal_tension"][:, 0]
    assert np.abs(np.diff(T_out[:10])).max() < 0.02
    assert np.ptp(T_out) > 0.0


def test_models_are_left_as_they_were_where_it_is_off():
    slave = started(AdaptationConfig())
    before = slave.prepared.tobytes()
    run(slave, pulls(0.0, 1.0))
    assert slave.adapter is None
    assert slave.prepared.tobytes() == before


def test_what_it_is_not_for_is_refused():
    config = SlaveConfig(adaptation=ON)
    config.check_arms(())
    SlaveConfig().check_arms((ArmConfig(),))
    with pytest.raises(UsageError, match=r"^slave\.adaptation\.enabled: .* share tendons"):
        config.check_arms((ArmConfig(),))
    with pytest.raises(ValueError, match="built-in estimator"):
        SlaveConfig(adaptation=ON, estimator=EstimatorExtension())
    replayed = ReplayedRigConfig(file=Path("data.csv"), tendons=(Columns(), Columns()))
    with pytest.raises(ValueError, match="replay one"):
        SlaveConfig(adaptation=ON, rig=replayed)


def test_a_sensing_loop_tells_k_of_a_rig_at_rest():
    tendon = TendonPlantConfig(SheathConfig(nodes=20), loop=SensingLoopConfig(period=0.5))
    bare = dataclasses.replace(tendon, loop=None)
    step = FrictionStep(start=2.0, change=0.3, tendon="a")
    config = SimulatedRigConfig(
        joints=(JointConfig((tendon, tendon)), JointConfig((tendon,)), JointConfig((bare,))),
        effects=(step,),
    )
    rig = SimulatedRig(config)
    models = [
        to_tendon_config(t, j.body.pretension).build_model()
        for j in config.joints
        for t in j.tendons
    ]
    slave = loop.init_slave(
        loop.build_rig_model(rig.joints, models), SlaveConfig(adaptation=ON), loop.DIRECT, True
    )
    K = [model.sheath.K for model in models]
    for k in range(4000):
        samples = rig.read(k * 1e-3)
        run(slave, to_sample_rows(samples))
    found = slave.prepared["tables"][:, tables.K] / K
    np.testing.assert_allclose(found, [1.3, 1.0, 1.3, 1.0], rtol=0.03)
    (sample,) = samples
    assert np.isnan(sample.loop_held_tension).tolist() == [False, False, False, True]
