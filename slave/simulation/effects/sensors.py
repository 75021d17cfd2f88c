"""Effects in the sensors and in the transmission of samples."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from estimator.array_types import Array
from slave.simulation.effects.effect import Effect
from slave.simulation.sensor_models import CHANNELS, Sensors
from teleop.config.ranges import build_ranged_field


@dataclass(frozen=True, slots=True)
class SensorEffect(Effect, ABC):
    """An effect in the sensors of a tendon."""

    tendon: Literal["a", "b", "both"] = "both"  # of the joint, on which it acts

    varies: ClassVar[bool] = False  # whether it varies after its start

    @abstractmethod
    def apply(self, sensors: Sensors, tendons: Sequence[int], time: float, /) -> Sensors:
        """Return the sensors with this effect on those of `tendons`, `time` [s] after its start."""


def replace_sensor_values(
    sensors: Sensors, field: str, place: object, change: Callable[[Array], Array | float]
) -> Sensors:
    """Return the sensors with the array `field` changed at `place`."""
    values = getattr(sensors, field).copy()
    values[place] = change(values[place])
    return sensors._replace(**{field: values})


@dataclass(frozen=True, slots=True)
class GainEffect(SensorEffect, ABC):
    """A load cell whose reading is (1 + gain) times the tension."""

    gain: float = build_ranged_field(0.06, -0.9, 9.0)  # relative error of the reading
    channel: ClassVar[int]

    def apply(self, sensors: Sensors, tendons: Sequence[int], _time: float, /) -> Sensors:
        return replace_sensor_values(
            sensors, "gain", (self.channel, tendons), lambda g: g * (1.0 + self.gain)
        )


@dataclass(frozen=True, slots=True)
class ProximalTensionGain(GainEffect):
    """Gain error of the load cell at the housing."""

    type: Literal["proximal_tension_gain"] = "proximal_tension_gain"
    channel: ClassVar[int] = 0


@dataclass(frozen=True, slots=True)
class DistalTensionGain(GainEffect):
    """Gain error of the bench load cell at the tip."""

    type: Literal["distal_tension_gain"] = "distal_tension_gain"
    channel: ClassVar[int] = 2


@dataclass(frozen=True, slots=True)
class BiasEffect(SensorEffect, ABC):
    """A load cell with a zero offset `bias`."""

    bias: float = build_ranged_field(0.4, -20.0, 20.0, "N")  # reading without tension
    channel: ClassVar[int]

    def apply(self, sensors: Sensors, tendons: Sequence[int], _time: float, /) -> Sensors:
        return replace_sensor_values(
            sensors, "bias", (self.channel, tendons), lambda b: b + self.bias
        )


@dataclass(frozen=True, slots=True)
class ProximalTensionBias(BiasEffect):
    """Zero offset of the load cell at the housing."""

    type: Literal["proximal_tension_bias"] = "proximal_tension_bias"
    channel: ClassVar[int] = 0


@dataclass(frozen=True, slots=True)
class DistalTensionBias(BiasEffect):
    """Zero offset of the bench load cell at the tip."""

    type: Literal["distal_tension_bias"] = "distal_tension_bias"
    channel: ClassVar[int] = 2


@dataclass(frozen=True, slots=True)
class DriftEffect(SensorEffect, ABC):
    """A load cell with a linear zero drift, up to a limit."""

    per_second: float = build_ranged_field(0.01, -10.0, 10.0, "N/s")  # rate of the drift
    limit: float = build_ranged_field(20.0, 0.0, 100.0, "N")  # largest drift
    varies: ClassVar[bool] = True
    channel: ClassVar[int]

    def apply(self, sensors: Sensors, tendons: Sequence[int], time: float, /) -> Sensors:
        bias = max(-self.limit, min(self.limit, self.per_second * time))
        return replace_sensor_values(sensors, "bias", (self.channel, tendons), lambda b: b + bias)


@dataclass(frozen=True, slots=True)
class ProximalTensionDrift(DriftEffect):
    """Zero drift of the load cell at the housing."""

    type: Literal["proximal_tension_drift"] = "proximal_tension_drift"
    channel: ClassVar[int] = 0


@dataclass(frozen=True, slots=True)
class DistalTensionDrift(DriftEffect):
    """Zero drift of the bench load cell at the tip."""

    type: Literal["distal_tension_drift"] = "distal_tension_drift"
    channel: ClassVar[int] = 2


@dataclass(frozen=True, slots=True)
class Saturation(SensorEffect):
    """A load cell that saturates at `limit`."""

    type: Literal["saturation"] = "saturation"
    limit: float = build_ranged_field(10.0, 0.1, 1e4, "N")  # largest reading
    # load cell on which it acts
    sensor: Literal["proximal_tension", "distal_tension"] = "proximal_tension"

    def apply(self, sensors: Sensors, tendons: Sequence[int], _time: float, /) -> Sensors:
        place = (CHANNELS.index(self.sensor), tendons)
        return replace_sensor_values(sensors, "range", place, lambda r: np.minimum(r, self.limit))


@dataclass(frozen=True, slots=True)
class SensorLag(SensorEffect):
    """A sensor lag: first-order low-pass filter."""

    type: Literal["sensor_lag"] = "sensor_lag"
    time_constant: float = build_ranged_field(0.06, 0.0, 10.0, "s")  # of the filter
    # on which it acts
    sensor: Literal[
        "proximal_tension", "proximal_displacement", "distal_tension", "distal_displacement"
    ] = "proximal_tension"

    def apply(self, sensors: Sensors, tendons: Sequence[int], _time: float, /) -> Sensors:
        place = (CHANNELS.index(self.sensor), tendons)
        return replace_sensor_values(sensors, "lag", place, lambda lag: lag + self.time_constant)


@dataclass(frozen=True, slots=True)
class EncoderScale(SensorEffect):
    """An encoder that reads (1 + gain) times the travel, as on a pulley of another radius."""

    type: Literal["encoder_scale"] = "encoder_scale"
    gain: float = build_ranged_field(0.04, -0.9, 9.0)  # relative error of the reading
    # encoder on which it acts
    sensor: Literal["proximal_displacement", "distal_displacement"] = "proximal_displacement"

    def apply(self, sensors: Sensors, tendons: Sequence[int], _time: float, /) -> Sensors:
        place = (CHANNELS.index(self.sensor), tendons)
        return replace_sensor_values(sensors, "gain", place, lambda g: g * (1.0 + self.gain))


@dataclass(frozen=True, slots=True)
class EncoderSlip(SensorEffect):
    """An encoder slip: a step of `slip` in the reading."""

    type: Literal["encoder_slip"] = "encoder_slip"
    slip: float = build_ranged_field(8e-5, -0.01, 0.01, "m")  # step of the reading
    # encoder on which it acts
    sensor: Literal["proximal_displacement", "distal_displacement"] = "proximal_displacement"

    def apply(self, sensors: Sensors, tendons: Sequence[int], _time: float, /) -> Sensors:
        place = (CHANNELS.index(self.sensor), tendons)
        return replace_sensor_values(sensors, "bias", place, lambda b: b + self.slip)


@dataclass(frozen=True, slots=True)
class CoggingRipple(SensorEffect):
    """The gear's ripple in the housing load cell: amplitude sin(order angle + phase)."""

    type: Literal["cogging_ripple"] = "cogging_ripple"
    amplitude: float = build_ranged_field(0.2, 0.0, 10.0, "N")  # of the ripple
    order: float = build_ranged_field(30.0, 1.0, 1e4)  # periods per turn of the pulley
    phase: float = build_ranged_field(0.0, -math.tau, math.tau, "rad")  # at the start
    adds_up: ClassVar[bool] = False

    def apply(self, sensors: Sensors, tendons: Sequence[int], _time: float, /) -> Sensors:
        sensors = replace_sensor_values(sensors, "ripple", tendons, lambda _: self.amplitude)
        sensors = replace_sensor_values(sensors, "ripple_order", tendons, lambda _: self.order)
        return replace_sensor_values(sensors, "ripple_phase", tendons, lambda _: self.phase)


@dataclass(frozen=True, slots=True)
class SheathRub(SensorEffect):
    """Friction of the sheath on its over-tube before the load cell: more while pulling, less after.

    The force follows the direction of the tendon's housing end, and changes over `travel`.
    """

    type: Literal["sheath_rub"] = "sheath_rub"
    friction: float = build_ranged_field(0.3, 0.0, 20.0, "N")  # force on the over-tube
    travel: float = build_ranged_field(2e-4, 1e-6, 0.1, "m")  # over which the force changes sides
    adds_up: ClassVar[bool] = False

    def apply(self, sensors: Sensors, tendons: Sequence[int], _time: float, /) -> Sensors:
        sensors = replace_sensor_values(sensors, "rub", tendons, lambda _: self.friction)
        return replace_sensor_values(sensors, "rub_travel", tendons, lambda _: self.travel)


@dataclass(frozen=True, slots=True)
class StuckCell(SensorEffect):
    """A stuck load cell: its reading stays constant."""

    type: Literal["stuck_cell"] = "stuck_cell"
    # load cell on which it acts
    sensor: Literal["proximal_tension", "distal_tension"] = "proximal_tension"

    def apply(self, sensors: Sensors, tendons: Sequence[int], _time: float, /) -> Sensors:
        return replace_sensor_values(
            sensors, "frozen", (CHANNELS.index(self.sensor), tendons), lambda _: 1.0
        )


@dataclass(frozen=True, slots=True)
class SampleEffect(Effect):
    """An effect on whole samples, in bursts of random length."""

    share: float = build_ranged_field(0.05, 0.0, 0.9)  # of all samples
    burst: float = build_ranged_field(1.0, 1.0, 1e4)  # mean length, in samples

    def __post_init__(self) -> None:
        """Check that bursts of this length can reach the share; raises `ValueError`."""
        Effect.__post_init__(self)
        share_max = self.burst / (1.0 + self.burst)
        if self.share > share_max:
            raise ValueError(
                f"share: must be at most {share_max:.2g} in bursts of {self.burst:g}; raise burst"
            )

    def is_struck(self, struck: bool, chance: float) -> bool:
        """Return whether this sample is affected; `chance` is uniform in 0 to 1."""
        if struck:
            return chance < 1.0 - 1.0 / self.burst
        return chance < self.share / ((1.0 - self.share) * self.burst)


@dataclass(frozen=True, slots=True)
class LostSamples(SampleEffect):
    """Samples that never arrive."""

    type: Literal["lost_samples"] = "lost_samples"


@dataclass(frozen=True, slots=True)
class RepeatedSamples(SampleEffect):
    """Samples that repeat the values of the one before, with a new time."""

    type: Literal["repeated_samples"] = "repeated_samples"


MeasurementEffect = (
    ProximalTensionGain
    | DistalTensionGain
    | ProximalTensionBias
    | DistalTensionBias
    | ProximalTensionDrift
    | DistalTensionDrift
    | Saturation
    | SensorLag
    | EncoderScale
    | EncoderSlip
    | CoggingRipple
    | SheathRub
    | StuckCell
    | LostSamples
    | RepeatedSamples
)
