"""Sensor models, at the housing and, on a bench, at the tip.

Every sensor has lag, gain, bias, noise, range and resolution.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, pi
from typing import Literal, NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from slave.simulation.motor import MotorConfig
from teleop.config.ranges import RangedConfig, build_ranged_field

CHANNELS = ("proximal_tension", "proximal_displacement", "distal_tension", "distal_displacement")


@dataclass(frozen=True, slots=True)
class LoadCellConfig(RangedConfig):
    """A load cell and its converter, for compression by up to `range` as under a sheath's end."""

    noise: float = build_ranged_field(0.010, 0.0, 10.0, "N")  # standard deviation, white
    # of the converter; 0 = no quantisation
    resolution: float = build_ranged_field(0.002, 0.0, 10.0, "N")
    range: float = build_ranged_field(100.0, 0.0, 1e5, "N", above=True)  # saturation, at both ends
    gain: float = build_ranged_field(1.0, 0.1, 10.0)  # reading over true tension
    bias: float = build_ranged_field(0.0, -100.0, 100.0, "N")  # reading without tension
    bandwidth: float = build_ranged_field(inf, 0.01, inf, "Hz")  # first order


@dataclass(frozen=True, slots=True)
class EncoderConfig(RangedConfig):
    """An encoder on the motor; 500 lines and a gear of 134:1 as in Phee et al. 2009."""

    # per revolution of the pulley, gear included; 0 = no quantisation
    lines: int = build_ranged_field(67_000, 0, 10**9)
    decoding: Literal[1, 2, 4] = 1  # counts per line; 4 = both edges of both tracks

    def compute_resolution(self, pulley_radius: float) -> float:
        """Return the tendon travel of one count [m] on a pulley of that radius [m]."""
        counts = self.lines * self.decoding
        return 2.0 * pi * pulley_radius / counts if counts else 0.0


class Sensors(NamedTuple):
    """The constants of all sensors of a rig."""

    # each of shape (4, tendons), by CHANNELS
    lag: Array  # [s] time constant
    gain: Array
    bias: Array  # [N] or [m]
    noise: Array  # [N] or [m] standard deviation
    range: Array  # [N] or [m]
    resolution: Array  # [N] or [m]
    frozen: Array  # 1 if the reading is frozen, else 0

    # disturbances of a housing load cell, each of shape (tendons,)
    ripple: Array  # [N] of the gear
    ripple_order: Array  # periods per turn of the pulley
    ripple_phase: Array  # [rad]
    rub: Array  # [N] of the sheath on its surroundings
    rub_travel: Array  # [m] of travel over which the rub reverses
    pulley_radius: Array  # [m]


class SensorState(NamedTuple):
    """State of the sensors of a rig."""

    reading: Array  # [N] or [m], shape (4, tendons)
    lagged: Array  # [N] or [m], shape (4, tendons)
    travel: Array  # [m] of the housing ends, shape (tendons,)
    rubbed: Array  # -1 to 1, shape (tendons,)


def build_sensors(tendons: Sequence[tuple[LoadCellConfig, EncoderConfig, MotorConfig]]) -> Sensors:
    """Return the sensors of a rig's tendons; those at the tip are ideal."""
    shape = (len(CHANNELS), len(tendons))
    sensors = Sensors(
        lag=np.zeros(shape),
        gain=np.ones(shape),
        bias=np.zeros(shape),
        noise=np.zeros(shape),
        range=np.full(shape, inf),
        resolution=np.zeros(shape),
        frozen=np.zeros(shape),
        ripple=np.zeros(len(tendons)),
        ripple_order=np.zeros(len(tendons)),
        ripple_phase=np.zeros(len(tendons)),
        rub=np.zeros(len(tendons)),
        rub_travel=np.ones(len(tendons)),
        pulley_radius=np.array([motor.pulley_radius for _, _, motor in tendons]),
    )
    for i, (cell, encoder, motor) in enumerate(tendons):
        sensors.lag[0, i] = 0.5 / (pi * cell.bandwidth)
        sensors.gain[0, i] = cell.gain
        sensors.bias[0, i] = cell.bias
        sensors.noise[0, i] = cell.noise
        sensors.range[0, i] = cell.range
        sensors.resolution[0, i] = cell.resolution
        sensors.resolution[1, i] = encoder.compute_resolution(motor.pulley_radius)
    return sensors


def init_sensors(truth: Array) -> SensorState:
    """Return the sensors' steady state at `truth`, shape (4, tendons)."""
    return SensorState(truth.copy(), truth.copy(), truth[1].copy(), np.zeros(truth.shape[1]))


@jit_compile
def measure(
    sensors: Sensors, state: SensorState, truth: Array, normal: Array, dt: float
) -> SensorState:
    """Return the sensors' readings `dt` [s] after `state`.

    `truth` [N], [m], shape (4, tendons), are the true values, `normal` as many standard normal
    deviates.
    """
    channels, tendons = truth.shape
    reading, lagged = np.empty((channels, tendons)), np.empty((channels, tendons))
    travel, rubbed = truth[1].copy(), np.empty(tendons)
    for tendon in range(tendons):
        play_travel = 2.0 * (travel[tendon] - state.travel[tendon]) / sensors.rub_travel[tendon]
        rubbed[tendon] = min(max(state.rubbed[tendon] + play_travel, -1.0), 1.0)
        angle = travel[tendon] / sensors.pulley_radius[tendon]
        wave = np.sin(sensors.ripple_order[tendon] * angle + sensors.ripple_phase[tendon])
        added = sensors.ripple[tendon] * wave + sensors.rub[tendon] * rubbed[tendon]
        for channel in range(channels):
            place = (channel, tendon)
            value = truth[place] + (added if channel == 0 else 0.0)
            if sensors.lag[place] > 0.0:
                decay = np.exp(-dt / sensors.lag[place])
                value += decay * (state.lagged[place] - value)
            lagged[place] = value
            value = sensors.gain[place] * value + sensors.bias[place]
            value += sensors.noise[place] * normal[place]
            value = min(max(value, -sensors.range[place]), sensors.range[place])
            step = sensors.resolution[place]
            value = round(value / step) * step if step > 0.0 else value
            reading[place] = state.reading[place] if sensors.frozen[place] else value
    return SensorState(reading, lagged, travel, rubbed)
