"""What the simulated plant costs: a step of a joint by nodes and effects, rigs against real time.

python -m studies.plant

Beside a step stand, from the same run, a call of a compiled function that does nothing with the
same arguments, which a step made from Python contains, and one solution of a tridiagonal system of
the chain's size by LAPACK, of which an iterating solver would need several. Beside a rig, read and
written at 1 kHz as a session does it, stand the same steps in one compiled call. Arms with links
of several masses take turns. Takes 30 s.
"""

import time

import numpy as np
from scipy.linalg import lapack

from estimator.array_types import Array
from estimator.compiled import jit_compile
from slave.rigs.simulated import (
    JointConfig,
    SimulatedRig,
    SimulatedRigConfig,
    TendonPlantConfig,
    build_joint,
)
from slave.simulation.arm import ArmPlantConfig
from slave.simulation.effects import compute_deviations
from slave.simulation.effects.elasticity import Creep, NonlinearStiffness
from slave.simulation.effects.friction import (
    ConstantDrag,
    FrictionStep,
    Presliding,
    StickSlip,
    StribeckFriction,
    TensionDependentFriction,
    ViscousFriction,
)
from slave.simulation.environment import FreeConfig
from slave.simulation.joint import BodyConfig, Joint, JointState, advance_joint, init_joint
from slave.simulation.tendon import SheathConfig
from studies.testbed.command import measure_us, parse_options
from teleop.config.arm import BendingSectionConfig

NODES = (10, 30, 60, 120, 300)
STEPS = 2000
MASSES = (0.0, 1e-6, 1e-3, 0.05)  # [kg] of each section of an arm
RIGS = ((1, 1), (1, 2), (2, 2), (4, 2), (8, 2))  # joints, tendons of each
SECONDS = 4.0
EFFECTS = (
    ConstantDrag(),
    TensionDependentFriction(),
    StribeckFriction(),
    StickSlip(),
    NonlinearStiffness(),
    Creep(),
    ViscousFriction(),
    Presliding(),
)


@jit_compile
def do_nothing(joint: Joint, state: JointState, targets: Array) -> float:
    """Only be called."""
    return joint.body.mass + state.travel + targets[0]


@jit_compile
def drive_joint(joint: Joint, state: JointState, path: Array) -> JointState:
    """Advance a joint along `path` [m], shape (steps, 2)."""
    for i in range(len(path)):
        state = advance_joint(joint, state, path[i], 1, 1e-3)
    return state


def generate_path(steps: int) -> Array:
    """Return where the motors of a pair go [m], shape (steps, 2): a sine, and its opposite."""
    wave = 4e-3 * (1.0 - np.cos(np.linspace(0.0, 3.0 * np.pi * steps / 1000.0, steps)))
    return np.column_stack([wave, 5e-4 - wave])


def build_config(tendons: int, nodes: int) -> JointConfig:
    return JointConfig((TendonPlantConfig(sheath=SheathConfig(nodes=nodes)),) * tendons)


def print_steps() -> None:
    print("one step of a joint [us]")
    print(
        f"{'nodes':>6} {'one tendon':>11} {'a pair':>7} {'bare call':>10} {'tridiagonal solve':>18}"
    )
    for nodes in NODES:
        took = []
        for tendons in (1, 2):
            joint = build_joint(build_config(tendons, nodes))
            start, way = init_joint(joint), generate_path(STEPS)
            took.append(measure_us(lambda: drive_joint(joint, start, way), 1, 3) / STEPS)  # noqa: B023
        call = measure_us(lambda: do_nothing(joint, start, way[0]), STEPS, 3)  # noqa: B023
        side, middle, right = np.full(nodes, -1.0), np.full(nodes + 1, 2.1), np.ones(nodes + 1)
        solve = measure_us(lambda: lapack.dgtsv(side, middle, side, right), STEPS, 3)  # noqa: B023
        print(f"{nodes:>6} {took[0]:>11.1f} {took[1]:>7.1f} {call:>10.1f} {solve:>18.1f}")


def print_effects() -> None:
    print("\none step of a joint with one tendon of 60 nodes, under one effect")
    joint, way = build_joint(build_config(1, 60)), generate_path(STEPS)
    start, plain = init_joint(joint), 0.0
    for effect in (FrictionStep(change=0.0), *EFFECTS):
        chain = joint.a.chain._replace(deviations=compute_deviations([effect], 10.0, [0.0]))
        changed = joint._replace(a=joint.a._replace(chain=chain))
        took = measure_us(lambda: drive_joint(changed, start, way), 1, 3) / STEPS  # noqa: B023
        plain = plain or took
        name = effect.type if effect in EFFECTS else "none"
        print(f"{name:>28} {took:>6.1f} us, {took / plain:.2f} times none")


def print_rigs() -> None:
    print("\nrigs of 60 nodes a tendon, times faster than real time")
    print(f"{'joints':>6} {'tendons':>8} {'read and written at 1 kHz':>26} {'steps alone':>12}")
    for joints, tendons in RIGS:
        config = build_config(tendons, 60)
        rig = SimulatedRig(SimulatedRigConfig(joints=(config,) * joints))
        way = np.tile(generate_path(round(1000 * SECONDS))[:, :tendons], joints)
        begin = time.perf_counter()
        for k, targets in enumerate(way):
            rig.read(k * 1e-3)
            rig.write(targets)
        whole = time.perf_counter() - begin
        joint = build_joint(config)
        start, steps = init_joint(joint), generate_path(round(1000 * SECONDS))
        alone = joints * 1e-6 * measure_us(lambda: drive_joint(joint, start, steps), 1, 3)  # noqa: B023
        print(
            f"{joints:>6} {joints * tendons:>8} {SECONDS / whole:>26.1f} {SECONDS / alone:>12.1f}"
        )


def print_arms() -> None:
    print(
        "\nan arm of eight joints, four curved sections, and 16 tendons of 60 nodes, by their mass"
    )
    radii = np.tril(np.full((8, 8), 0.003), -1) + np.diag([0.004] * 8)
    body = BodyConfig(spring=0.0, stops=(-0.0065, 0.0065))
    joint = JointConfig((TendonPlantConfig(),) * 2, body, FreeConfig())
    rigs = []
    for mass in MASSES:
        sections = tuple(BendingSectionConfig(f"s{k}", 0.05, mass=mass) for k in range(4))
        arm = ArmPlantConfig(tuple(map(tuple, radii.tolist())), sections=sections)
        rigs.append(SimulatedRig(SimulatedRigConfig(joints=(joint,) * 8, arms=(arm,))))
    took, rate, ratio = np.zeros(len(rigs)), np.linspace(2.0, 7.0, 8), radii / 0.004
    for block in range(20):  # in turns, since a machine's speed changes
        for i, rig in enumerate(rigs):
            begin = time.process_time()
            for k in range(200 * block, 200 * (block + 1)):
                pull = ratio @ (0.004 * np.sin(1e-3 * k * rate))
                rig.write(np.column_stack([1e-3 + pull, 1e-3 - pull]).ravel())
                rig.read(k * 1e-3)
            took[i] += time.process_time() - begin
    for mass, seconds in zip(MASSES, took, strict=True):
        print(
            f"{mass:>8g} kg {250.0 * seconds:>6.0f} us a step, {seconds / took[0]:.3f} times none"
        )


if __name__ == "__main__":
    parse_options(__doc__)
    print_steps()
    print_effects()
    print_rigs()
    print_arms()
