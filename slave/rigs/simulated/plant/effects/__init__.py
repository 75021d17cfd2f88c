"""Effects that a config can switch on in a simulated rig, for data with a known fault.

An effect is a frozen dataclass whose `type` names it in a config file. It changes the knobs of a
tendon (`TendonEffect`), the constants of a joint (`JointEffect`) or of sensors (`SensorEffect`), or
drops or repeats samples (`SampleEffect`); `schedule` applies it in time.

To add one, define it in the module of its family, add it to `EffectConfig` below, and describe it
in docs/rigs.md.
"""

from slave.rigs.simulated.plant.effects.along import BrokenTendon, JammedTendon, NonuniformCurvature
from slave.rigs.simulated.plant.effects.effect import (
    Effect,
    TendonEffect,
    build_ranged_field,
    compute_knobs,
    select_tendon_effects,
)
from slave.rigs.simulated.plant.effects.elasticity import (
    Creep,
    NonlinearStiffness,
    SheathCompression,
    Slack,
    ThermalExpansion,
)
from slave.rigs.simulated.plant.effects.ends import (
    AntagonistTension,
    JointBacklash,
    JointFriction,
    Pretension,
    PulleyEccentricity,
    TipInertia,
    TipMotion,
)
from slave.rigs.simulated.plant.effects.friction import (
    ConstantDrag,
    DirectionAsymmetry,
    FrictionDrift,
    FrictionStep,
    Presliding,
    StickSlip,
    StribeckFriction,
    TensionDependentFriction,
    ViscousFriction,
)
from slave.rigs.simulated.plant.effects.sensors import (
    CoggingRipple,
    DistalTensionBias,
    DistalTensionDrift,
    DistalTensionGain,
    EncoderScale,
    EncoderSlip,
    LostSamples,
    ProximalTensionBias,
    ProximalTensionDrift,
    ProximalTensionGain,
    RepeatedSamples,
    Saturation,
    SensorLag,
    SheathRub,
    StuckCell,
)

__all__ = [
    "Effect",
    "EffectConfig",
    "TendonEffect",
    "build_ranged_field",
    "compute_knobs",
    "select_tendon_effects",
]

EffectConfig = (
    FrictionStep
    | FrictionDrift
    | ConstantDrag
    | ViscousFriction
    | StribeckFriction
    | Presliding
    | DirectionAsymmetry
    | TensionDependentFriction
    | StickSlip
    | NonlinearStiffness
    | Creep
    | SheathCompression
    | Slack
    | ThermalExpansion
    | NonuniformCurvature
    | Pretension
    | JointBacklash
    | JointFriction
    | AntagonistTension
    | TipInertia
    | TipMotion
    | PulleyEccentricity
    | BrokenTendon
    | JammedTendon
    | ProximalTensionGain
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
