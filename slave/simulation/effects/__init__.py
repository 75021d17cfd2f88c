"""Effects that a config can switch on in a simulated rig, for data with a known fault.

An effect is a frozen dataclass whose `type` names it in a config file. It changes the deviations of
a tendon (`TendonEffect`), the constants of a joint (`JointEffect`) or of sensors (`SensorEffect`),
or drops or repeats samples (`SampleEffect`); `schedule` applies it in time.

To add one, define it in the module of its family, and add it to the union at the module's end.
"""

from slave.simulation.effects.effect import (
    Effect,
    TendonEffect,
    compute_deviations,
    select_tendon_effects,
)
from slave.simulation.effects.elasticity import ElasticityEffect, FailureEffect
from slave.simulation.effects.ends import EndEffect
from slave.simulation.effects.friction import FrictionEffect
from slave.simulation.effects.sensors import MeasurementEffect

__all__ = ["Effect", "EffectConfig", "TendonEffect", "compute_deviations", "select_tendon_effects"]

EffectConfig = FrictionEffect | ElasticityEffect | EndEffect | FailureEffect | MeasurementEffect
