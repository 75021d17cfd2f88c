"""Joints under tendon control on the simulated rig: all but the link and the session."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.law.sheath import Sheath
from estimator.online import online
from estimator.structs import StructArray, to_struct, view_struct
from slave import control, fault_detection, gate
from slave.control import ControlConfig, ControllerState, JointEstimate
from slave.fault_detection import FaultDetectionConfig
from slave.gate import GateConfig
from slave.rig import RigSample
from slave.rig_layout import EstimatedTendon, build_rig_layout
from slave.rigs.simulated import JointConfig, SimulatedRig, SimulatedRigConfig, TendonPlantConfig
from slave.sheath_section import SectionConfig
from slave.simulation.environment import EnvironmentConfig, FreeConfig
from slave.simulation.joint import BodyConfig
from slave.simulation.sensor_models import LoadCellConfig
from slave.simulation.tendon import SheathConfig
from teleop.messages.messages import MAX_JOINTS, MAX_TENDONS
from teleop.session.state_machine import Reason

Array = NDArray[np.float64]
Command = Callable[[float], tuple[float, float]]  # [s] to travel [m] and its velocity [m/s]
Fault = tuple[Reason, int]  # and which tendon it is

DT = 0.001  # [s]
NO_ARM = np.full((3, MAX_JOINTS), np.nan)
BEGIN = 0.02  # [s] at which the session engages
L, EA, MU = 1.5, 9000.0, 0.15
CONFIG = ControlConfig()
LIMITS = GateConfig(displacement_min=-0.05, displacement_max=0.05, speed_max=0.1)


class Record(NamedTuple):
    """What happened, one row a tick from engagement on."""

    asked: Array  # [m] shape (n, joints)
    travel: Array  # [m] true, shape (n, joints)
    tension: Array  # [N] measured at the housing, shape (n, tendons)
    motor: Array  # [m] what the gate let through, shape (n, tendons)
    position: Array  # [m] of the joints, estimated, shape (n, joints)
    found: tuple[tuple[float, Fault], ...]  # [s] since the rig's start, and each new fault

    def error(self, joint: int = 0) -> tuple[float, float]:
        """Return the RMS and the largest tracking error of a joint [m]."""
        error = self.travel[:, joint] - self.asked[:, joint]
        return float(np.sqrt(np.mean(error**2))), float(np.abs(error).max())


def build_joint(
    K: float,
    spring: float = 0.0,
    environment: EnvironmentConfig | None = None,
    tendons: int = 2,
    noise: float = 0.02,
    resolution: float = 0.002,
    pretension: float = 0.5,
    sections: tuple[SectionConfig, ...] = (),
    nodes: int = 20,
    **body: float | tuple[float, float],
) -> JointConfig:
    """Return a joint whose sheaths have one bend, or `sections`."""
    tendon = TendonPlantConfig(
        sheath=SheathConfig(sections or (SectionConfig(L, MU * L / K),), MU, EA, nodes),
        load_cell=LoadCellConfig(noise=noise, resolution=resolution),
    )
    settings = {"friction": 0.1, "spring": spring, "pretension": pretension} | body
    return JointConfig((tendon,) * tendons, BodyConfig(**settings), environment or FreeConfig())


def build_model(
    tendon: TendonPlantConfig, pretension: float, K_error: float, EA_error: float
) -> online.TendonModel:
    """Return what a calibration that is wrong by so much would tell: one even bend."""
    sections = tendon.sheath.sections
    K = tendon.sheath.friction * sum(section.length / section.radius for section in sections)
    length = sum(section.length for section in sections)
    step = tendon.encoder.compute_resolution(tendon.motor.pulley_radius)
    return online.TendonModel(
        Sheath.uniform(K * K_error, length, tendon.sheath.axial_stiffness * EA_error),
        tension_noise=math.hypot(tendon.load_cell.noise, tendon.load_cell.resolution / 12**0.5),
        displacement_noise=step / 12**0.5,
        initial=pretension or "slack",
    )


def to_tendon_records(sample: RigSample, estimates: Sequence[online.TendonEstimate]) -> StructArray:
    """Return the tendons of a sample as records, shape (MAX_TENDONS,)."""
    tendons = EstimatedTendon.array(MAX_TENDONS)
    for k, estimate in enumerate(estimates):
        tendon = view_struct(tendons, k)
        tendon.tension = sample.proximal_tension[k]
        if sample.proximal_displacement is not None:
            tendon.displacement = sample.proximal_displacement[k]
        tendon.valid = not estimate.status & online.Status.INVALID_INPUT
        tendon.estimate = estimate
    return tendons


def pad_array(values: Sequence[float], length: int) -> Array:
    """Return an array of this length that begins with `values`, zero beyond."""
    return np.array([*values, *[0.0] * (length - len(values))])


def follow(
    joints: Sequence[JointConfig],
    commands: Sequence[Command],
    seconds: float,
    config: ControlConfig = CONFIG,
    *,
    errors: tuple[float, float] = (1.02, 1.03),  # what the model has of K and EA, over the truth
    effects: Sequence[object] = (),
    until_found: bool = False,
    seed: int = 1,
) -> Record:
    """Let joints follow commands, which begin as the session engages."""
    rig = SimulatedRig(SimulatedRigConfig(joints=tuple(joints), effects=tuple(effects), seed=seed))
    models = [
        build_model(tendon, j.body.pretension, *errors) for j in joints for tendon in j.tendons
    ]
    prepared = [online.prepare(m) for m in models]
    states = [online.build_initial_state(p) for p in prepared]
    layout, settings, limits = (
        view_struct(build_rig_layout(rig.joints)),
        to_struct(config),
        to_struct(LIMITS),
    )
    memory, detector = ControllerState.new(), view_struct(fault_detection.init_detector(models))
    detection = to_struct(FaultDetectionConfig())
    motor, wanted, offsets = np.zeros(MAX_TENDONS), np.zeros(MAX_TENDONS), np.zeros(MAX_JOINTS)
    told, no_reach = JointEstimate.array(MAX_JOINTS), gate.Reach.array(0)
    rows, found = [], []
    for k in range(round(seconds / DT)):
        time = k * DT
        (sample,) = rig.read(time)
        estimates = []
        for i, (p, T, q) in enumerate(
            zip(
                prepared,
                sample.proximal_tension.tolist(),
                sample.proximal_displacement.tolist(),
                strict=True,
            )
        ):
            estimate, states[i] = online.step(p, states[i], T, q, DT if k else 0.0)
            estimates.append(estimate)
        tendons = to_tendon_records(sample, estimates)
        if k == 0:
            control.compute_offsets(layout, tendons, offsets)
        fault = fault_detection.step(detection, layout, detector, tendons, DT if k else 0.0)
        if fault[0] is not Reason.NONE and (not found or found[-1][1] != fault):
            found.append((time, fault))
            if until_found:
                break
        if time < BEGIN:
            continue
        asked, velocity = zip(*(command(time - BEGIN) for command in commands), strict=True)
        control.step(
            settings, layout, memory, pad_array(asked, MAX_JOINTS), pad_array(velocity, MAX_JOINTS),
            motor, tendons, True, DT, wanted,
        )  # fmt: skip
        tension = sample.proximal_tension
        gate.step(
            limits, rig.tendons, motor, wanted, tension, 0.0, True, DT, no_reach, False, False,
            motor,
        )  # fmt: skip
        sent = motor[: rig.tendons].copy()
        rig.write(sent)
        control.estimate_joints(layout, tendons, offsets, NO_ARM, told)
        firsts = [j[0] for j in rig.joints]
        position = told["position"][: len(rig.joints)].copy()
        rows.append((asked, sample.bench_distal_displacement[firsts], tension, sent, position))
    return Record(*(np.array(column) for column in zip(*rows, strict=True)), tuple(found))


def build_stairs(levels: Sequence[float], speed: float, rest: float) -> Command:
    """Go to each level [m] at `speed` [m/s] and rest there for so long [s]; stay at the last."""

    def at(time: float) -> tuple[float, float]:
        here = 0.0
        for level in levels:
            way = level - here
            if time < abs(way) / speed:
                return here + math.copysign(speed * time, way), math.copysign(speed, way)
            time -= abs(way) / speed
            if time < rest:
                return level, 0.0
            time -= rest
            here = level
        return here, 0.0

    return at


def build_sine(amplitude: float, frequency: float) -> Command:
    """Swing to and fro by so much [m], so often [Hz]."""
    rate = 2.0 * math.pi * frequency
    return lambda time: (
        amplitude * math.sin(rate * time),
        amplitude * rate * math.cos(rate * time),
    )


def hold_still(_time: float) -> tuple[float, float]:
    """Stay."""
    return 0.0, 0.0
