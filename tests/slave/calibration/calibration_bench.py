"""Simulated rigs to calibrate: a joint with two tendons, of which the housing alone is seen."""

import dataclasses
from typing import get_args

from slave.calibration.config import InitialiseConfig, KnownSheathConfig
from slave.calibration.procedure_run import ProcedureLimits, generate_fast_ticks, run_procedure
from slave.gate import GateConfig
from slave.rig import RigSample
from slave.rigs.simulated import JointConfig, SimulatedRig, SimulatedRigConfig, TendonPlantConfig
from slave.sheath_section import SectionConfig
from slave.simulation.effects import EffectConfig
from slave.simulation.environment import FreeConfig
from slave.simulation.joint import BodyConfig
from slave.simulation.sensor_models import LoadCellConfig
from slave.simulation.tendon import SheathConfig

LENGTH, EA = 1.5, 9000.0
EVEN = (SectionConfig(LENGTH, 0.225),)
TIGHT_FIRST = (SectionConfig(0.2, 0.05), SectionConfig(1.3, 0.5))
GATE = GateConfig(displacement_min=-0.06, displacement_max=0.06)
KNOWN = InitialiseConfig(sheaths=(KnownSheathConfig(LENGTH, EA),))
QUICK = KNOWN.to_quick()
RANGE = 0.030  # [m] between the stops


def joint(
    K=1.0, sections=EVEN, tendons=2, noise=0.01, body=None, environment=None, nodes=30, **cell
):
    bend = sum(section.length / section.radius for section in sections)
    tendon = TendonPlantConfig(
        sheath=SheathConfig(sections, K / bend, EA, nodes),
        load_cell=LoadCellConfig(noise=noise, **cell),
    )
    standard = {"friction": 0.2, "spring": 0.0, "stops": (-RANGE / 2, RANGE / 2)}
    return JointConfig(
        (tendon,) * tendons, BodyConfig(**standard | (body or {})), environment or FreeConfig()
    )


def rig_config(*joints, effects=(), seed=1, period=2e-3):
    return SimulatedRigConfig(
        name="bench", joints=joints, period=period, seed=seed, effects=effects
    )


class HousingOnly:
    """A simulated rig without its sensors at the tip; those are kept for the test to judge by."""

    starts_at_zero = True

    def __init__(self, config):
        self.rig = SimulatedRig(config)
        self.name, self.joints, self.tendons = self.rig.name, self.rig.joints, self.rig.tendons
        self.written, self.seen, self.closed = [], [], 0

    def read(self, time_s):
        samples = self.rig.read(time_s)
        self.seen += samples
        return tuple(
            RigSample(s.time_s, s.proximal_tension, s.proximal_displacement) for s in samples
        )

    def write(self, proximal_displacement):
        self.written.append(proximal_displacement.tolist())
        self.rig.write(proximal_displacement)

    def summarise(self):
        return {}

    def close(self):
        self.closed += 1


def calibrated(rig, initialise=QUICK, gate=GATE, rate_hz=1000.0, joints=None, **how):
    """Do the procedure on a rig, or on the rig of a config."""
    rig = rig if hasattr(rig, "read") else HousingOnly(rig)
    joints = range(len(rig.joints)) if joints is None else joints
    return run_procedure(
        rig, ProcedureLimits(initialise, gate), generate_fast_ticks(rate_hz), 0, joints, **how
    )


def but(config, **changes):
    return dataclasses.replace(config, **changes)


def effect(name, **parameters):
    (kind,) = [c for c in get_args(EffectConfig) if c.__dataclass_fields__["type"].default == name]
    return kind(**parameters)
