"""Joint torques of random arms, estimated from the housing, against the simulated arm.

  python -m studies.arm                       20 arms of 2 to 8 joints, 20 s each
  python -m studies.arm --arms 4 --seed 7 --known
  python -m studies.arm --contact             tip of an arm pressed on planes of five orientations,
                                              and in postures that are nearly singular
  python -m studies.arm --calibrate configs/notes-arm.yaml     calibrated, against wrong by 30 %

Radii, sheaths, friction of passed joints, motion and walls are drawn at random. The slave's loop
runs as in a session, without link and clock. Errors are parts of the full scale, the largest
tension of the gate at a joint's pulley; once with the friction of passed joints in the model, once
without. Takes 15 minutes.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.kinematics.arm import prepare_arm
from estimator.kinematics.forward import compute_jacobian, compute_tip_pose
from estimator.kinematics.tip_wrench import compute_tip_wrench
from estimator.structs import view_struct
from slave import loop
from slave.calibration.calibration_file import Calibration, apply_guide_friction
from slave.calibration.initialisation import initialise
from slave.calibration.procedure_run import generate_fast_ticks
from slave.config import AS_BUILT, SlaveConfig, load_tendon_configs, to_tendon_config
from slave.gate import GateConfig
from slave.loop_records import SlaveMemory, TickInput
from slave.rigs.simulated import JointConfig, SimulatedRig, SimulatedRigConfig, TendonPlantConfig
from slave.samples import estimate, to_sample_rows
from slave.sheath_section import SectionConfig
from slave.simulation.arm import ArmPlantConfig
from slave.simulation.environment import FreeConfig, WallConfig
from slave.simulation.joint import BodyConfig
from slave.simulation.sensor_models import LoadCellConfig
from slave.simulation.space_contacts import PlaneConfig
from slave.simulation.tendon import SheathConfig
from slave.tendon_config import TendonConfig
from studies.testbed.command import parse_options
from teleop.config.arm import ArmConfig
from teleop.config.loading import ConfigDocument
from teleop.messages.messages import MAX_JOINTS, Command, SlaveState, pad_values
from teleop.messages.packet import Packet
from teleop.session.config import RunConfig
from teleop.session.state_machine import State

DT = 1e-3  # [s]
TENSION_MAX = 40.0  # [N] full scale
GOAL = 0.03  # of the full scale, for the error of any joint
TENSION_NOISE = 0.02  # [N] of the load cells; an encoder's count is 1 um
NODES = 12  # of a tendon of an arm that is calibrated, for speed
BEGIN_S = 3.0  # [s] from which on errors count: the arm has moved once
RADII = ((0.005, 0.0, 0.0), (0.004, 0.005, 0.0), (0.004, 0.004, 0.005))  # [m]
ARM: dict[str, Any] = {
    "radii": RADII,
    "friction": 0.1,
    "wrap": 0.3,
    "urdf": Path(__file__).parents[1] / "configs" / "notes-arm.urdf",
    "tip": "tip",
}
ARM_ANGLES = (0.0, 0.05, -0.1)  # [rad] its smallest lever is 14 mm
NEAR_SINGULAR = ((0.0, 0.3, -0.6), (0.0, 0.3, -0.8), (0.0, 0.6, -0.95))  # 8.6, 5.3 and 2.9 mm
NORMALS = ((0, 0, -1), (1, 0, -1), (-1, 0, -1), (0, 1, -1), (0, -1, -1))
PRESS_M, PLANE_STIFFNESS = 0.006, 3000.0  # [m] commanded depth, [N/m]
TURN_S = 2.5  # [s] when it is deepest
CONTACT_MIN = 1.0  # [N] from which on a force at the tip has a direction


class Errors(NamedTuple):
    """Errors of the forces on the joints of one arm, as parts of the full scale."""

    mean: float
    largest: float
    near: float  # part of the time with all joints within `GOAL`
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
        joints.append(
            JointConfig(
                (TendonPlantConfig(sheath, load_cell=LoadCellConfig(noise=TENSION_NOISE)),) * 2,
                body,
                wall,
            )
        )
    arm = ArmPlantConfig(
        tuple(map(tuple, radii.tolist())),
        friction=random.uniform(0.05, 0.15),
        wrap=random.uniform(0.0, 0.6),
    )
    return SimulatedRigConfig(joints=tuple(joints), arms=(arm,), seed=int(random.integers(1 << 30)))


def run_arm(config: SimulatedRigConfig, friction: float, seconds: float, seed: int) -> Errors:
    """Run an arm with `friction` at passed joints in the model; the motion is that of the seed."""
    plant = config.arms[0]
    return run_model(config, ArmConfig(plant.radii, friction, plant.wrap), seconds, seed)


def run_model(
    config: SimulatedRigConfig,
    arm: ArmConfig,
    seconds: float,
    seed: int,
    tendons: Sequence[TendonConfig] = (),
) -> Errors:
    """Run an arm with a model of it, and of its `tendons`, by default as built."""
    n, random = len(config.joints), np.random.default_rng(seed)
    rate, phase = 2.0 * np.pi * random.uniform(0.1, 0.6, n), random.uniform(0.0, 6.3, n)
    rows = [
        collect_forces(rig, memory)
        for time, rig, memory in run_slave(
            config,
            arm,
            lambda time: 0.004 * min(time / 2.0, 1.0) * np.sin(rate * time + phase),
            seconds,
            tendons,
        )
        if time > BEGIN_S
    ]
    true, force, low, high = np.array(rows).transpose(1, 0, 2)
    error = np.abs(force - true) / TENSION_MAX
    inside = ((low <= true) & (true <= high)).mean()
    near, width = (error.max(axis=1) <= GOAL).mean(), (high - low).mean() / 2.0 / TENSION_MAX
    return Errors(error.mean(), error.max(), near, inside, width)


def run_slave(
    config: SimulatedRigConfig,
    arm: ArmConfig,
    travel: Callable[[float], Array],
    seconds: float,
    tendons: Sequence[TendonConfig] = (),
) -> Iterator[tuple[float, SimulatedRig, SlaveMemory]]:
    """Command the `travel` [m] of all joints, and yield time [s], rig and memory of each tick."""
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
    tendons = tendons or load_tendon_configs(slave_config, rig.tendons)
    model = loop.build_rig_model(rig.joints, [t.build_model() for t in tendons], arms=[arm])
    slave = loop.init_slave(model, slave_config, loop.DIRECT, starts_at_zero=True)
    memory: SlaveMemory = view_struct(slave.memory)
    command, state = Packet(Command), Packet(SlaveState)
    for i in range(round(seconds / DT)):
        time = i * DT
        samples = rig.read(time)
        records = to_sample_rows(samples)
        estimate(*slave.estimate_arguments, records, len(samples))
        message = Command(
            sender=1,
            stamp_ns=i + 1,
            sequence=i,
            state=int(State.READY if time < 0.1 else State.ENGAGED),
            position=pad_values(tuple(travel(time).tolist()), MAX_JOINTS),
            coupling=loop.DIRECT.signature,
            force_max=1e3,
        )
        command.fill(message)
        loop.run_tick(
            *slave.tick_arguments, records, len(samples), TickInput(DT, True, True),
            command.records, state.records,
        )  # fmt: skip
        if memory.has_gated_position:
            rig.write(np.array(memory.gated_position[: rig.tendons]))
        yield time, rig, memory


def compare_calibration(path: Path, seconds: float, seed: int) -> None:
    """Calibrate the simulated arm of a config; print what was found, and errors of joint forces."""
    document = ConfigDocument.read(path, [])
    shared, slave = document.load(RunConfig), document.load(SlaveConfig, "slave")
    assert isinstance(slave.rig, SimulatedRigConfig)  # noqa: S101 - a study
    cell = LoadCellConfig(noise=TENSION_NOISE)
    free = [
        replace(
            joint,
            tendons=tuple(
                replace(t, load_cell=cell, sheath=replace(t.sheath, nodes=NODES))
                for t in joint.tendons
            ),
            environment=FreeConfig(),
        )
        for joint in slave.rig.joints
    ]
    plants = tuple(replace(arm, contacts=()) for arm in slave.rig.arms)
    rig = replace(slave.rig, joints=tuple(free), arms=plants, period=0.002)
    found = initialise(
        SimulatedRig(rig), slave, generate_fast_ticks(500.0), 0, arms=shared.arms
    ).calibration
    for direction in found.directions:
        print(f"joint {direction.joint} {direction.tendon}: K {direction.K}")
    for guide in found.guides:
        print(f"joint {guide.joint}: mu {guide.friction}")
    print_model_errors(replace(rig, period=0.001), shared.arms[0], found, seconds, seed)


def print_model_errors(
    rig: SimulatedRigConfig, arm: ArmConfig, found: Calibration, seconds: float, seed: int
) -> None:
    """Print errors of joint forces with a calibration, and with K and friction wrong by 30 %."""
    wall = WallConfig(position=0.002, stiffness=3000.0)
    rig = replace(rig, joints=tuple(replace(joint, environment=wall) for joint in rig.joints))
    models = [("calibrated", apply_guide_friction([arm], found.guides)[0], found.tendons)]
    for ratio in (1.3, 0.7):
        wrong = tuple(mu * ratio for mu in arm.list_friction())
        built = [
            to_tendon_config(t, joint.body.pretension)
            for joint in rig.joints
            for t in joint.tendons
        ]
        tendons = tuple(replace(t, friction=(t.friction or 0.0) * ratio) for t in built)
        models.append((f"friction times {ratio}", replace(arm, friction=wrong), tendons))
    print(f"{'':18}{'mean':>8}{'largest':>9}{'inside':>8}")
    for name, model, tendons in models:
        errors = run_model(rig, model, seconds, seed, tendons)
        print(f"{name:18}{errors.mean:8.2%}{errors.largest:9.2%}{errors.inside:8.1%}", flush=True)


class TipErrors(NamedTuple):
    """Errors of the force at the tip that presses on a plane, in determined directions."""

    angle: Array  # [rad] between the estimated and the true force: median, 95 %, largest
    size: Array  # error of its size, relative: the same
    inside: float  # part of the time within the interval of each component
    told: float  # part of the time for which all of the force is told
    force: float  # [N] largest
    angle_pressing: float  # [rad] 95 % before the motors turn back
    size_pressing: float


def press_plane(normal: Sequence[float], angles: Sequence[float] = ARM_ANGLES) -> TipErrors:
    """Press the tip of an arm of three joints, at `angles` [rad], on a plane and let go of it."""
    unit, q = np.array(normal) / np.linalg.norm(normal), np.array(angles)
    radius = np.diag(RADII)
    known = ArmConfig(**ARM)
    prepared = prepare_arm(known.load_kinematics())[0]
    point, jacobian = compute_tip_pose(prepared, q)[:3, 3], compute_jacobian(prepared, q)[:3]
    pressed = np.linalg.lstsq(jacobian, -PRESS_M * unit, rcond=0.1)[0]
    plane = PlaneConfig(point=tuple(point), normal=tuple(unit), stiffness=PLANE_STIFFNESS)
    sections = (SectionConfig(0.4), SectionConfig(0.5, 0.15), SectionConfig(0.4, 0.4))
    tendon = TendonPlantConfig(
        SheathConfig(sections, friction=0.16), load_cell=LoadCellConfig(noise=TENSION_NOISE)
    )
    body = BodyConfig(mass=0.02, friction=0.1, spring=0.0, stops=(-0.0065, 0.0065))
    config = SimulatedRigConfig(
        joints=(JointConfig((tendon,) * 2, body, FreeConfig()),) * len(q),
        arms=(ArmPlantConfig(**ARM, contacts=(plane,)),),
    )

    def travel(time: float) -> Array:
        press = 0.5 - 0.5 * np.cos(np.pi * min(max(time - TURN_S + 1.0, 0.0), 2.0))
        wanted: Array = radius * (min(time, 1.0) * q + press * pressed)
        return wanted

    rows, times = [], []
    for time, rig, memory in run_slave(config, known, travel, 3.5):
        tip = compute_tip_pose(prepared, rig.joint_travel / radius)[:3, 3]
        true = -unit * PLANE_STIFFNESS * max(float(unit @ (point - tip)), 0.0)
        estimates = [memory.joints[k] for k in range(len(q))]
        position = np.array([joint.position for joint in estimates])
        torque = radius * np.array([(joint.force, joint.low, joint.high) for joint in estimates]).T
        found = compute_tip_wrench(compute_jacobian(prepared, position / radius), *torque)
        told = found.directions[found.is_identified][:, :3]
        seen = told.T @ (told @ true)
        if np.linalg.norm(true) > CONTACT_MIN:
            times.append(time)
            rows.append(
                (true, seen, found.wrench[:3], found.low[:3], found.high[:3], found.is_identified)
            )
    true, seen, force, low, high, is_identified = np.array(rows, np.float64).transpose(1, 0, 2)
    size, estimated = np.linalg.norm(seen, axis=1), np.linalg.norm(force, axis=1)
    angle = np.arccos(np.clip((seen * force).sum(axis=1) / (size * estimated), -1.0, 1.0))
    inside = ((low <= true) & (true <= high)).all(axis=1).mean()
    error = np.abs(estimated - size) / size
    is_seen = size > CONTACT_MIN
    presses = is_seen & (np.array(times) < TURN_S)
    (angles_seen, angle_pressing), (errors_seen, error_pressing) = (
        [compute_percentiles(values[chosen]) for chosen in (is_seen, presses)]
        for values in (angle, error)
    )
    return TipErrors(
        angles_seen,
        errors_seen,
        inside,
        is_identified.min(axis=1).mean(),
        np.linalg.norm(true, axis=1).max(),
        angle_pressing[1],
        error_pressing[1],
    )


def compute_percentiles(values: Array) -> Array:
    """Return percentiles 50, 95 and 100, NaN where nothing was seen."""
    return np.asarray(np.percentile(values, (50.0, 95.0, 100.0)) if len(values) else [np.nan] * 3)


def collect_forces(rig: SimulatedRig, memory: SlaveMemory) -> list[Array]:
    """Return the true force on each joint and the estimate with its ends [N]."""
    joints = [memory.joints[k] for k in range(len(rig.joints))]
    ends = [
        np.array([getattr(joint, name) for joint in joints]) for name in ("force", "low", "high")
    ]
    return [rig.joint_forces, *ends]


def main() -> None:
    """Print a table, a row for each arm."""
    args = parse_options(
        __doc__,
        arms=(20, "number of arms"),
        seconds=(20.0, "of each"),
        seed=(1, "of the first arm"),
        known=(False, "leave out the runs without friction of passed joints in the model"),
        contact=(False, "force at a tip on planes"),
        calibrate=(Path, "config of a simulated arm to calibrate"),
    )
    if args.calibrate:
        compare_calibration(args.calibrate, args.seconds, args.seed)
        return
    if args.contact:
        print(
            "angles [rad]       normal           largest  angle: median  95 %   size: median   "
            "95 %   pressing: 95 %         inside    told"
        )
        near = itertools.product(NEAR_SINGULAR, NORMALS[1:4:2])  # of motions that it can make
        for angles, normal in [*((ARM_ANGLES, normal) for normal in NORMALS), *near]:
            found = press_plane(normal, angles)
            print(
                f"{angles!s:18} {normal!s:15}  {found.force:5.1f} N  "
                f"{np.degrees(found.angle[0]):9.1f} deg  {np.degrees(found.angle[1]):4.1f}  "
                f"{found.size[0]:13.1%}  {found.size[1]:5.1%}  "
                f"{np.degrees(found.angle_pressing):8.1f} deg {found.size_pressing:7.1%}  "
                f"{found.inside:7.2%}  {found.told:6.1%}",
                flush=True,
            )
        return
    print(
        "joints  friction   mean   largest  within 3 %   inside   half-width   "
        "without friction: mean  inside"
    )
    for seed in range(args.seed, args.seed + args.arms):
        config = draw_arm(np.random.default_rng(seed))
        friction = config.arms[0].list_friction()[0]
        known = run_arm(config, friction, args.seconds, seed)
        line = (
            f"{len(config.joints):6d}  {friction:8.3f}  {known.mean:6.2%}  {known.largest:6.2%}  "
            f"{known.near:10.2%}  {known.inside:8.3%}  {known.width:9.2%}"
        )
        if not args.known:
            without = run_arm(config, 0.0, args.seconds, seed)
            line += f"   {without.mean:13.2%}  {without.inside:.2%}"
        print(line, flush=True)


if __name__ == "__main__":
    main()
