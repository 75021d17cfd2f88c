"""Joint torques of random arms, estimated from the housing, against the simulated arm.

  python studies/arm.py                       20 arms of 2 to 8 joints, 20 s each
  python studies/arm.py --arms 4 --seed 7

Radii, sheaths, friction of passed joints, motion and walls are drawn at random. The slave's loop
runs as in a session, without link and clock. Errors are parts of the full scale, the largest
tension of the gate at a joint's pulley; once with the friction of passed joints in the model, once
without.
"""

import argparse
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.records import view_struct
from slave import loop
from slave.config import AS_BUILT, SlaveConfig, load_tendon_configs
from slave.gate import GateConfig
from slave.loop_records import SlaveMemory, TickInput
from slave.rigs.simulated import JointConfig, SimulatedRig, SimulatedRigConfig, TendonPlantConfig
from slave.samples import estimate, to_sample_rows
from slave.sheath_section import SectionConfig
from slave.simulation.arm import ArmPlantConfig
from slave.simulation.environment import WallConfig
from slave.simulation.joint import BodyConfig
from slave.simulation.tendon import SheathConfig
from teleop.config.arm import ArmConfig
from teleop.messages.messages import Command, SlaveState
from teleop.messages.packet import Packet
from teleop.session.state_machine import State

DT = 1e-3  # [s]
TENSION_MAX = 40.0  # [N] full scale
BEGIN_S = 3.0  # [s] from which on errors count: the arm has moved once


class Errors(NamedTuple):
    """Errors of the forces on the joints of one arm, as parts of the full scale."""

    mean: float
    largest: float
    inside: float  # part of the time within the interval
    width: float  # mean half-width of the interval


def draw_arm(random: np.random.Generator) -> SimulatedRigConfig:
    """Return a random arm of two to eight joints whose tendons pass those before them."""
    n = int(random.integers(2, 9))
    own = random.uniform(0.003, 0.006, n)
    radii = np.tril(random.uniform(-0.8, 0.8, (n, n)) * own[:, None], -1) + np.diag(own)
    joints = []
    for _ in range(n):
        sections = (
            SectionConfig(random.uniform(0.2, 0.5)),
            SectionConfig(random.uniform(0.3, 0.6), random.uniform(0.12, 0.4)),
        )
        sheath = SheathConfig(sections, friction=random.uniform(0.08, 0.2))
        wall = WallConfig(
            position=random.uniform(0.0005, 0.003), stiffness=random.uniform(1e3, 6e3)
        )
        body = BodyConfig(mass=0.02, friction=0.1, spring=0.0, stops=(-0.0065, 0.0065))
        joints.append(JointConfig((TendonPlantConfig(sheath),) * 2, body, wall))
    arm = ArmPlantConfig(
        tuple(map(tuple, radii.tolist())),
        friction=random.uniform(0.05, 0.15),
        wrap=random.uniform(0.0, 0.6),
    )
    return SimulatedRigConfig(joints=tuple(joints), arms=(arm,), seed=int(random.integers(1 << 30)))


def run_arm(config: SimulatedRigConfig, friction: float, seconds: float, seed: int) -> Errors:
    """Run an arm with `friction` at passed joints in the model; the motion is that of the seed."""
    slave_config = SlaveConfig(
        rig=config,
        calibration=AS_BUILT,
        gate=GateConfig(
            displacement_min=-0.05,
            displacement_max=0.05,
            tension_max=TENSION_MAX,
            exceed_bounds=True,
        ),
    )
    rig = SimulatedRig(config)
    plant = config.arms[0]
    arm = ArmConfig(plant.radii, friction=friction, wrap=plant.wrap)
    tendons = load_tendon_configs(slave_config, rig.tendons)
    model = loop.build_rig_model(rig.joints, [t.model() for t in tendons], arms=[arm])
    slave = loop.init_slave(model, slave_config, loop.DIRECT, starts_at_zero=True)
    memory: SlaveMemory = view_struct(slave.memory)
    command, state = Packet(Command), Packet(SlaveState)
    n, random = len(rig.joints), np.random.default_rng(seed)
    rate, phase = 2.0 * np.pi * random.uniform(0.1, 0.6, n), random.uniform(0.0, 6.3, n)
    rows = []
    for i in range(round(seconds / DT)):
        time = i * DT
        samples = rig.read(time)
        records = to_sample_rows(samples)
        estimate(*slave.estimate_arguments, records, len(samples))
        travel = 0.004 * min(time / 2.0, 1.0) * np.sin(rate * time + phase)
        message = Command(
            sender=1,
            stamp_ns=i + 1,
            sequence=i,
            state=int(State.READY if time < 0.1 else State.ENGAGED),
            position=(*travel.tolist(), *[0.0] * (8 - n)),
            coupling=loop.DIRECT.signature,
            force_max=1e3,
        )
        command.fill(message)
        loop.run_tick(
            *slave.tick_arguments, records, len(samples), TickInput(DT, True, True),
            command.records, state.records,
        )  # fmt: skip
        if memory.has_motor:
            rig.write(np.array(memory.motor[: rig.tendons]))
        if time > BEGIN_S:
            rows.append(collect_forces(rig, memory))
    true, force, low, high = np.array(rows).transpose(1, 0, 2)
    error = np.abs(force - true) / TENSION_MAX
    inside = ((low <= true) & (true <= high)).mean()
    return Errors(error.mean(), error.max(), inside, (high - low).mean() / 2.0 / TENSION_MAX)


def collect_forces(rig: SimulatedRig, memory: SlaveMemory) -> list[Array]:
    """Return the true force on each joint and the estimate with its ends [N]."""
    a, b = rig.arm_tensions.transpose(1, 0, 2)
    n = len(a)
    joints = [memory.joints[k] for k in range(n)]
    ends = [
        np.array([getattr(joint, name) for joint in joints]) for name in ("force", "low", "high")
    ]
    return [(rig.travel_ratios * (a - b)).sum(axis=0), *ends]


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table, a row for each arm."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--arms", type=int, default=20, help="number of arms (default 20)")
    parser.add_argument("--seconds", type=float, default=20.0, help="of each (default 20)")
    parser.add_argument("--seed", type=int, default=1, help="of the first arm (default 1)")
    args = parser.parse_args(arguments)
    print(
        "joints  friction   mean   largest   inside   half-width   without friction: mean  inside"
    )
    for seed in range(args.seed, args.seed + args.arms):
        config = draw_arm(np.random.default_rng(seed))
        friction = config.arms[0].friction
        known = run_arm(config, friction, args.seconds, seed)
        without = run_arm(config, 0.0, args.seconds, seed)
        print(
            f"{len(config.joints):6d}  {friction:8.3f}  {known.mean:6.2%}  {known.largest:6.2%}  "
            f"{known.inside:8.3%}  {known.width:9.2%}   {without.mean:13.2%}  {without.inside:.2%}",
            flush=True,
        )


if __name__ == "__main__":
    main()
