"""Effects that a config can switch on in a simulated rig, for data with a known fault.

An effect is a frozen dataclass whose `type` names it in a config file. It changes the knobs of a
tendon (`TendonEffect`), the constants of a joint (`JointEffect`) or of sensors (`SensorEffect`), or
drops or repeats samples (`SampleEffect`); `schedule` applies it in time.

To add one, define it in the module of its family, add it to `EffectConfig` below, and describe it
in docs/rigs.md.
"""

from slave.simulation.effects.effect import (
    Effect,
    TendonEffect,
    compute_knobs,
    select_tendon_effects,
)
from slave.simulation.effects.elasticity import (
    BrokenTendon,
    Creep,
    JammedTendon,
    NonlinearStiffness,
    NonuniformCurvature,
    SheathCompression,
    Slack,
    ThermalExpansion,
)
from slave.simulation.effects.ends import (
    AntagonistTension,
    JointBacklash,
    JointFriction,
    Pretension,
    PulleyEccentricity,
    TipInertia,
    TipMotion,
)
from slave.simulation.effects.friction import (
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
from slave.simulation.effects.sensors import (
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
