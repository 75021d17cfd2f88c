"""Compile and import what a slave calls, before it has to be on time."""

from functools import partial
from importlib import import_module

import numpy as np

from estimator.records import Records
from slave import loop
from slave.calibration import run as calibration_run
from slave.config import SlaveConfig
from slave.loop_records import EstimatedSample, TickInput
from slave.rig import RigSample
from slave.rigs import RIG_COMPILE_S, compile_rig
from slave.samples import estimate_with_dynamics, fill_sample
from slave.score import Score
from slave.state_messages import fill_tendon_state, fill_tension_profile
from slave.tendon_config import TendonConfig
from teleop.link.health import compile_observer
from teleop.messages.messages import (
    PROFILE_POINTS,
    Command,
    SlaveState,
    TendonState,
    TensionProfile,
)
from teleop.messages.packet import Packet
from teleop.runtime.clock import quiet_garbage
from teleop.runtime.compiling import announced

COMPILE_S = 24.0  # [s] of a processor for the tick, without a cache
DYNAMICS_COMPILE_S = 14.0  # [s] more


def prepare(config: SlaveConfig, with_dynamics: bool) -> None:
    """Compile and import what the session calls, before it runs at real-time priority.

    Models of a diagnosis may have effects `with_dynamics`, which take longer.
    """
    about_s = (
        COMPILE_S + RIG_COMPILE_S.get(type(config.rig), 0.0) + DYNAMICS_COMPILE_S * with_dynamics
    )
    # the collector would look in vain through a million objects of the compiler: 10 % of its time
    with quiet_garbage(), announced("the slave's loop", about_s, partial(_compile_rest, config)):
        _compile_tick()
        if with_dynamics:
            slave, rows, _ = _example()
            estimate_with_dynamics(*slave.estimated, rows, 1)
        if config.initialise.at_start:
            calibration_run.warm_up()
    if config.initialise.at_start:
        import_module("scipy.optimize")  # which the analysis of a calibration uses


def _compile_rest(config: SlaveConfig) -> None:
    """Compile what the session calls beside the tick: as much work again."""
    compile_rig(config.rig)
    _compile_follow_up()


def _compile_tick() -> None:
    slave, rows, state = _example()
    given, command = TickInput(1e-3, True, False), Packet(Command)
    slave.estimate(*slave.estimated, rows, 1)
    loop.tick(*slave.ticked, rows, 1, given, command.records, state.records)


def _compile_follow_up() -> None:
    """Compile what is called once the state is published."""
    slave, rows, state = _example()
    loop.monitor_calibration(slave.settings, slave.layout, slave.watched, slave.memory, rows, 1)
    fill_tendon_state(slave.layout, slave.memory, rows, 0, Packet(TendonState).records)
    Score().add_rows(slave.layout, rows, 1)
    compile_observer()
    points, profile = np.zeros(PROFILE_POINTS), Packet(TensionProfile)
    fill_tension_profile(slave.prepared, slave.estimators, slave.memory, 0, points, profile.records)
    state.seal(0, 0, 0)


def _example() -> tuple[loop.Slave, Records, Packet[SlaveState]]:
    """Return a slave of one tendon, a sample of it, and room for its state."""
    model = loop.rig_model(((0,),), [TendonConfig(effective_friction=1.0).model()])
    slave = loop.start(model, SlaveConfig(), loop.DIRECT, starts_at_zero=True)
    rows, state = EstimatedSample.array(), Packet(SlaveState)
    fill_sample(rows, 0, RigSample(0.0, np.ones(1), np.zeros(1)))
    return slave, rows, state
