"""Records of simulated arms with one thing changed, which a diagnosis across joints has to name.

  python -m studies.hidden_effects.arms --seeds 3   two arms, eleven changes each, a line a record

The plant (slave.simulation) shares no code with what is fitted: chains of springs, beads at the
passed joints, bodies. All channels have noise: 0.02 N and 1 um, at a joint's pulley for its angle.
Takes an hour.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.diagnosis import arm_model, arm_report
from estimator.diagnosis.arm import ArmDiagnosis, diagnose_arm
from estimator.law.sheath import Sheath
from estimator.routing.routing import Routing
from slave.arm_estimate import build_routing, cut_sheaths
from slave.config import AS_BUILT, SlaveConfig, load_tendon_configs
from slave.rig import number_joint_tendons
from slave.rigs.simulated import JointConfig, SimulatedRig, SimulatedRigConfig, TendonPlantConfig
from slave.sheath_section import SectionConfig
from slave.simulation.arm import ArmPlantConfig
from slave.simulation.environment import FreeConfig
from slave.simulation.joint import BodyConfig
from slave.simulation.sensor_models import EncoderConfig, LoadCellConfig
from slave.simulation.tendon import SheathConfig
from studies.testbed.command import parse_options
from teleop.config.arm import ArmConfig

TENSION_NOISE, TRAVEL_NOISE = 0.02, 1e-6  # [N], [m]
RATE, SETTLE_S = 100.0, 1.0  # [Hz] of the samples, [s] left out at the start
PRELOAD_M, SWING_M, SWELL = 0.0012, 0.0028, 0.4  # stretch of both tendons, travel, share of stretch
GAIN, PLAY_M, RADIUS, FRICTION = 1.08, 1e-4, 1.1, 1.5  # what the changes amount to


class Shape(NamedTuple):
    """An arm as its config describes it, and as it is while nothing is changed."""

    radii: tuple[tuple[float, ...], ...]
    friction: float
    wrap: float
    single: tuple[int, ...] = ()  # joints that one tendon turns against a spring


SHAPES = {
    "notes": Shape(
        (
            (0.005, 0.0, 0.0, 0.0),
            (0.004, 0.005, 0.0, 0.0),
            (0.004, 0.004, 0.005, 0.0),
            (0.004, 0.004, 0.004, 0.005),
        ),
        0.1,
        0.3,
    ),
    "crossed": Shape(
        ((0.006, 0.0, 0.0), (-0.0035, 0.0045, 0.0), (0.003, -0.004, 0.004)), 0.15, 0.6, (0,)
    ),
}


@dataclass(frozen=True)
class Change:
    """What is wrong with an arm: a kind, and the joint and pair or tendon that it is in, from 0."""

    kind: str = "clean"
    joint: int = -1
    row: int = -1  # tendons of a joint; for a tendon's own fault, the joint it turns
    side: int = 0


class ArmRecord(NamedTuple):
    """A record: arrays of shape (samples, tendons), angles (samples, joints)."""

    time: Array
    proximal_tension: Array
    proximal_displacement: Array
    anchor_tension: Array
    angles: Array


def list_changes(shape: Shape) -> list[Change]:
    """Return the changes to be hidden in an arm: one thing each."""
    last = len(shape.radii) - 1
    return [
        Change(),
        Change("friction", joint=0),
        Change("friction", joint=1),
        Change("radius", joint=0),
        Change("radius", joint=1),
        Change("sign", joint=0, row=last),
        Change("missing", joint=1, row=last),
        Change("gain", row=1, side=1),
        Change("gain", row=last),
        Change("play", row=last, side=1),
        Change("play", row=1),
    ]


def describe_rig(shape: Shape, change: Change, seed: int) -> SimulatedRigConfig:
    """Return the config of an arm with a change; friction of a single joint is none of it."""
    radii = np.array(shape.radii)
    if change.kind == "radius":
        radii[:, change.joint] *= RADIUS
    elif change.kind in ("sign", "missing"):
        radii[change.row, change.joint] *= -1.0 if change.kind == "sign" else 0.0
    sections = (SectionConfig(0.4), SectionConfig(0.5, 0.15), SectionConfig(0.4, 0.4))
    joints = []
    for k in range(len(radii)):
        cells = [LoadCellConfig(noise=TENSION_NOISE, resolution=0.0)] * 2
        if change.kind == "gain" and k == change.row:
            cells[change.side] = replace(cells[change.side], gain=GAIN)
        sheath = SheathConfig(sections, friction=0.14 + 0.01 * k)
        is_single = k in shape.single
        tendons = tuple(
            TendonPlantConfig(sheath, load_cell=cell, encoder=EncoderConfig(lines=0))
            for cell in cells[: 1 if is_single else 2]
        )
        body = BodyConfig(mass=0.02, friction=0.1, spring=1500.0 if is_single else 0.0)
        joints.append(JointConfig(tendons, body, FreeConfig()))
    arm = ArmPlantConfig(tuple(map(tuple, radii.tolist())), shape.friction, shape.wrap)
    return SimulatedRigConfig(joints=tuple(joints), arms=(arm,), seed=seed)


def build_rig(shape: Shape, change: Change, seed: int) -> SimulatedRig:
    """Return the plant of an arm with a change."""
    rig = SimulatedRig(describe_rig(shape, change, seed))
    if change.kind == "friction":
        arm = rig._arm
        friction = np.where(arm.guide == change.joint, FRICTION, 1.0) * arm.friction
        rig._arm = arm._replace(friction=friction)
    return rig


def _build_motion(shape: Shape, random: np.random.Generator) -> Callable[[float], Array]:
    """Return motor targets [m] over time: all joints to and fro, and a stretch that swells."""
    radii = np.array(shape.radii)
    own = np.abs(np.diag(radii))
    n = len(radii)
    rates = 2.0 * np.pi * random.permutation(np.linspace(0.11, 0.37, n))
    phases = random.uniform(0.0, 2.0 * np.pi, n)
    swells = 2.0 * np.pi * random.uniform(0.05, 0.15, n)

    def move(time: float) -> Array:
        ramp = min(time / SETTLE_S, 1.0)
        angles = ramp * SWING_M / own * np.sin(rates * time + phases)
        travel = radii @ angles
        stretch = ramp * PRELOAD_M * (1.0 + SWELL * np.sin(swells * time))
        targets = []
        for k in range(n):
            targets += [travel[k] + stretch[k]]
            if k not in shape.single:
                targets += [stretch[k] - travel[k]]
        return np.array(targets)

    return move


def make(shape: Shape, change: Change, seed: int, duration: float = 30.0) -> ArmRecord:
    """Return a record of an arm with a change; the motion and the noise are those of the seed."""
    random = np.random.default_rng(seed)
    rig, move = build_rig(shape, change, seed), _build_motion(shape, random)
    own = np.abs(np.diag(shape.radii))
    steps, every = round((duration + SETTLE_S) * 1e3), round(1e3 / RATE)
    rows: list[tuple[Array, ...]] = []
    for step in range(steps):
        time = step * 1e-3
        (sample,) = rig.read(time)
        rig.write(move(time))
        if time >= SETTLE_S and step % every == 0:
            ends = rig.anchor_tensions
            noise = random.normal(0.0, TRAVEL_NOISE, len(own)) / own
            readings = sample.proximal_tension, sample.proximal_displacement
            rows.append((*readings, ends, rig.joint_angles + noise))
    T, q_p, anchor, angles = (np.array(column) for column in zip(*rows, strict=True))
    if change.kind == "play":
        k = _find_tendon(shape, change)
        q_p[:, k] = _lag_behind(q_p[:, k], PLAY_M)
    q_p += random.normal(0.0, TRAVEL_NOISE, q_p.shape)
    anchor += random.normal(0.0, TENSION_NOISE, anchor.shape)
    return ArmRecord(np.arange(len(T)) / RATE, T, q_p, anchor, angles)


def _find_tendon(shape: Shape, change: Change) -> int:
    return sum(1 if k in shape.single else 2 for k in range(change.row)) + change.side


def _lag_behind(travel: Array, play: float) -> Array:
    """Return the reading of an encoder whose coupling has play."""
    reading = travel.copy()
    for i in range(1, len(travel)):
        before = reading[i - 1]
        reading[i] = min(max(before, travel[i] - play / 2), travel[i] + play / 2)
    return reading


def describe_known(shape: Shape) -> tuple[Routing, list[Sheath], tuple[str, ...]]:
    """Return what a config knows of an arm: routing, sheaths and names of its tendons."""
    config = SlaveConfig(rig=describe_rig(shape, Change(), 1), calibration=AS_BUILT)
    joints = number_joint_tendons([1 if k in shape.single else 2 for k in range(len(shape.radii))])
    names = tuple(f"{k}{'ab'[i]}" for k, own in enumerate(joints, 1) for i in range(len(own)))
    arms = [ArmConfig(shape.radii, shape.friction, shape.wrap)]
    tendons = load_tendon_configs(config, len(names))
    sheaths = cut_sheaths([tendon.build_model().sheath for tendon in tendons], joints, arms)
    return build_routing(joints, arms), sheaths, names


def diagnose(shape: Shape, record: ArmRecord) -> ArmDiagnosis:
    """Diagnose a record with what a config knows of its arm."""
    routing, sheaths, names = describe_known(shape)
    data = arm_model.ArmData(*record, is_at_anchor=True, has_encoders=True, names=names)
    return diagnose_arm(data, routing, sheaths)


def is_right(shape: Shape, change: Change, found: ArmDiagnosis) -> bool:
    """Return whether the one cause that is named is the change, with its joint and tendons."""
    if change.kind == "clean" or len(found.causes) != 1:
        return change.kind == "clean" and found.is_clean
    cause = found.causes[0].cause
    kind = {
        "friction": "passed_joint_friction",
        "radius": "joint_radius",
        "sign": "coupling",
        "missing": "coupling",
        "gain": "proximal_tension_gain",
        "play": "encoder_play",
    }[change.kind]
    first = _find_tendon(shape, replace(change, side=0))
    tendons = {first + change.side}
    if change.kind in ("sign", "missing"):
        tendons = {first} if change.row in shape.single else {first, first + 1}
    elif change.joint >= 0:
        tendons = set(cause.tendons)
    return cause.kind == kind and cause.joint == change.joint and set(cause.tendons) == tendons


def main() -> None:
    """Print a line for each record, and how many are right."""
    options = parse_options(
        __doc__,
        seeds=(3, "how many"),
        seed=(1, "the first"),
        seconds=(30.0, "of a record"),
    )
    right = count = 0
    for seed in range(options.seed, options.seed + options.seeds):
        for name, shape in SHAPES.items():
            for change in list_changes(shape):
                record = make(shape, change, seed, options.seconds)
                begin = time.process_time()
                found = diagnose(shape, record)
                took, is_named = time.process_time() - begin, is_right(shape, change, found)
                right, count = right + is_named, count + 1
                verdict = "right" if is_named else "WRONG"
                place = f"joint {change.joint + 1}, row {change.row + 1}, side {change.side}"
                print(f"{seed} {name} {change.kind} ({place}): {verdict}, {took:.0f} s")
                print(f"  {arm_report.format_headline(found)}", flush=True)
    print(f"{right} of {count} right")


if __name__ == "__main__":
    main()
