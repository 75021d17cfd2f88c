"""Compile and import what a slave calls, before it has to be on time."""

from collections.abc import Sequence
from functools import partial
from importlib import import_module

import numpy as np

from estimator.array_types import Array
from estimator.structs import StructArray
from slave import loop
from slave.calibration import procedure_run as calibration_run
from slave.config import SlaveConfig
from slave.force_error import Score
from slave.loop_records import EstimatedSample, TickInput
from slave.rig import RigSample
from slave.rigs import RIG_COMPILE_S, compile_rig
from slave.samples import estimate, fill_sample
from slave.state_messages import fill_tendon_state, fill_tension_profile
from slave.tendon_config import TendonConfig
from teleop.config.arm import ArmConfig
from teleop.link.health import compile_link_window_update
from teleop.messages.messages import (
    MAX_TENDONS,
    PROFILE_POINTS,
    Command,
    SlaveState,
    TendonState,
    TensionProfile,
)
from teleop.messages.packet import Packet
from teleop.runtime.clock import pause_garbage_collection
from teleop.runtime.compiling import announce_compilation

COMPILE_S = 24.0  # [s] of a processor for the tick, without a cache
DYNAMICS_COMPILE_S = 14.0  # [s] more
ARM_COMPILE_S = 8.0  # [s] more
ADAPTATION_COMPILE_S = 15.0  # [s] more


def compile_session(
    config: SlaveConfig, with_dynamics: bool, arms: Sequence[ArmConfig] = ()
) -> None:
    """Compile and import what the session calls, before it runs at real-time priority.

    Models of a diagnosis may have effects `with_dynamics`, which take longer; so do `arms`.
    """
    about_s = COMPILE_S + RIG_COMPILE_S.get(type(config.rig), 0.0)
    about_s += DYNAMICS_COMPILE_S * with_dynamics + ARM_COMPILE_S * bool(arms)
    about_s += ADAPTATION_COMPILE_S * config.adaptation.enabled
    # the collector would look in vain through a million objects of the compiler: 10 % of its time
    with (
        pause_garbage_collection(),
        announce_compilation("the slave's loop", about_s, partial(_compile_outside_tick, config)),
    ):
        _compile_tick(config, arms)
        if with_dynamics:
            slave, rows, _ = _build_example(config, arms)
            estimate(
                *slave._replace(with_dynamics=True).estimate_arguments, rows, 1, *_list_own(config)
            )
        if config.initialise.at_start:
            calibration_run.warm_up()
    if config.initialise.at_start:
        import_module("scipy.optimize")  # which the analysis of a calibration uses


def _compile_outside_tick(config: SlaveConfig) -> None:
    """Compile what the session calls beside the tick: as much work again."""
    compile_rig(config.rig)
    _compile_finish_tick(config)


def _compile_tick(config: SlaveConfig, arms: Sequence[ArmConfig]) -> None:
    slave, rows, state = _build_example(config, arms)
    tick_input, command = TickInput(1e-3, True, False), Packet(Command)
    estimate(*slave.estimate_arguments, rows, 1, *_list_own(config))
    loop.run_tick(*slave.tick_arguments, rows, 1, tick_input, command.records, state.records)


def _list_own(config: SlaveConfig) -> list[Array]:
    """Return the last argument of `estimate` where there is an estimator of another package."""
    return [] if config.estimator is None else [np.zeros((1, 4, MAX_TENDONS))]


def _compile_finish_tick(config: SlaveConfig) -> None:
    """Compile what is called once the state is published."""
    slave, rows, _ = _build_example(config)
    loop.monitor_calibration(*slave.monitor_arguments, rows, 1)
    fill_tendon_state(slave.layout, slave.memory, rows, 0, Packet(TendonState).records)
    Score().add_rows(slave.layout, rows, 1)
    compile_link_window_update()
    points, profile = np.zeros(PROFILE_POINTS), Packet(TensionProfile)
    fill_tension_profile(slave.prepared, slave.estimators, slave.memory, 0, points, profile.records)


def _build_example(
    config: SlaveConfig, arms: Sequence[ArmConfig] = ()
) -> tuple[loop.SlaveRecords, StructArray, Packet[SlaveState]]:
    """Return a slave of one tendon, a sample of it, and room for its state."""
    tendon = TendonConfig(effective_friction=1.0).build_model()
    model = loop.build_rig_model(((0,),), [tendon], arms=[ArmConfig()] if arms else [])
    example = SlaveConfig(adaptation=config.adaptation)
    slave = loop.init_slave(model, example, loop.DIRECT, starts_at_zero=True)
    rows, state = EstimatedSample.array(), Packet(SlaveState)
    fill_sample(rows, 0, RigSample(0.0, np.ones(1), np.zeros(1)))
    return slave, rows, state
