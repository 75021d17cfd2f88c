"""A simulated rig: motors, elastic tendons in their sheaths, joints, noisy sensors."""

import dataclasses
import math
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.compiled import jit_compile
from slave.rig import RigFault, RigSample, number_joint_tendons
from slave.simulation.arm import (
    Arm,
    ArmPlantConfig,
    advance_arm,
    balance_springs,
    build_arm,
    init_arm,
)
from slave.simulation.effects import EffectConfig
from slave.simulation.effects.ends import AntagonistTension
from slave.simulation.effects.schedule import JointSchedule, SampleSchedule, SensorSchedule
from slave.simulation.environment import (
    EnvironmentConfig,
    EnvironmentRamp,
    FreeConfig,
    TissueConfig,
    build_environment,
    replace_number,
)
from slave.simulation.joint import (
    BodyConfig,
    Joint,
    JointState,
    Tendon,
    Winding,
    advance_joints,
    build_body,
    init_joint,
    replace_item,
    to_compiled_list,
)
from slave.simulation.motor import MotorConfig, build_motor
from slave.simulation.sensing_loop import SensingLoopConfig, SensingLoops
from slave.simulation.sensor_models import (
    CHANNELS,
    EncoderConfig,
    LoadCellConfig,
    Sensors,
    SensorState,
    build_sensors,
    init_sensors,
    measure,
)
from slave.simulation.tendon import SheathConfig, build_chain
from teleop.config.arm import assemble_lengths, assemble_tendon_rows
from teleop.config.ranges import build_ranged_field, check_ranges
from teleop.messages.messages import MAX_JOINTS

NOISE_STEPS = 16  # of which the noise is drawn at once
CATCH_UP_STEPS_MAX = 10  # at a late read; if it is later still, longer steps are taken


@dataclass(frozen=True, slots=True)
class TendonPlantConfig:
    """A tendon in its sheath, the motor that winds it and the sensors at the housing."""

    sheath: SheathConfig = field(default_factory=SheathConfig)
    motor: MotorConfig = field(default_factory=MotorConfig)
    load_cell: LoadCellConfig = field(default_factory=LoadCellConfig)
    encoder: EncoderConfig = field(default_factory=EncoderConfig)
    loop: SensingLoopConfig | None = None  # in the same tube


@dataclass(frozen=True, slots=True)
class JointConfig:
    """One joint, pulled by one tendon against its spring or by two against each other."""

    tendons: tuple[TendonPlantConfig, ...] = (TendonPlantConfig(),)  # a, or a and b
    body: BodyConfig = field(default_factory=BodyConfig)
    environment: EnvironmentConfig = field(default_factory=TissueConfig)  # what the joint touches

    def __post_init__(self) -> None:
        """Check the number of tendons; raises `ValueError`."""
        if len(self.tendons) not in (1, 2):
            raise ValueError("tendons: must be 1 or 2")


@dataclass(frozen=True, slots=True)
class SimulatedRigConfig:
    """A rig of one joint or several."""

    type: Literal["simulated"] = "simulated"
    name: str = "simulated"  # name of the rig in calibration files
    joints: tuple[JointConfig, ...] = (JointConfig(),)
    arms: tuple[ArmPlantConfig, ...] = ()  # whose joints share tendons: the first of `joints`
    period: float = build_ranged_field(0.001, 1e-5, 0.01, "s")  # step of the plant
    seed: int = build_ranged_field(1, 0, math.inf)  # of the sensors' noise
    effects: tuple[EffectConfig, ...] = ()  # faults and deviations, docs/how-to/rigs.md

    def __post_init__(self) -> None:
        """Check joints, period and effects; raises `ValueError`."""
        check_ranges(self)
        if not self.name.strip():
            raise ValueError("name: must not be empty")
        if not 1 <= len(self.joints) <= MAX_JOINTS:
            raise ValueError(f"joints: must be 1 to {MAX_JOINTS}")
        for number, joint in enumerate(self.joints, 1):
            longest = min(map(compute_step_max, joint.tendons))
            if self.period > longest:
                raise ValueError(
                    f"period: must be at most {longest:.2g} s for the rotor inertia of joint "
                    f"{number} (motor.rotor_inertia, motor.gear)"
                )
        validate_effects(self.effects, [len(joint.tendons) for joint in self.joints])
        if not self.arms:
            return
        try:
            self.list_pretensions()
        except ValueError as error:
            raise ValueError(f"arms: {error}") from error
        for i, joint in enumerate(self.joints):
            if joint.body.backlash > 0.0:
                raise ValueError(f"joints.{i}.body.backlash: must be 0 on a rig with arms")

    def list_pretensions(self) -> list[list[float]]:
        """Return the tension of the tendons of each joint at the start [N]; `ValueError` of arms.

        Tendons that balance in other than equal shares have at least that of the first of them.
        """
        joints = number_joint_tendons([len(joint.tendons) for joint in self.joints])
        pulls = np.array([joint.body.pretension for joint in self.joints for _ in joint.tendons])
        for members, balance in assemble_tendon_rows(self.arms, joints).groups:
            pulls[members] = balance * pulls[members[0]]
        return [pulls[list(tendons)].tolist() for tendons in joints]

    def list_arm_lengths(self) -> list[float]:
        """Return the length of each tendon in an arm, behind its sheath [m]."""
        joints = number_joint_tendons([len(joint.tendons) for joint in self.joints])
        travel = assemble_tendon_rows(self.arms, joints).travel
        return [float(length) for length in assemble_lengths(self.arms, travel).sum(axis=1)]


def validate_effects(effects: Sequence[EffectConfig], counts: Sequence[int]) -> None:
    """Check effects against joints of `counts` tendons each.

    Raises `ValueError`.
    """
    for i, effect in enumerate(effects):
        if effect.joint is not None and effect.joint > len(counts):
            raise ValueError(f"effects[{i}].joint: must be 1 to {len(counts)}")
        chosen = counts if effect.joint is None else counts[effect.joint - 1 : effect.joint]
        if isinstance(effect, AntagonistTension) and 2 not in chosen:
            raise ValueError(f"effects[{i}].joint: must have two tendons")
        sides = find_effect_sides(effect, counts)
        if not sides:
            raise ValueError(f"effects[{i}].tendon: must be a, no joint has a tendon b")
        for k, other in enumerate(effects[:i]):
            is_duplicate = other.type == effect.type and not effect.adds_up
            if is_duplicate and sides & find_effect_sides(other, counts):
                raise ValueError(
                    f"effects[{i}]: must be on another tendon than effects[{k}]; two of type "
                    f"{effect.type} cannot be combined"
                )


def find_effect_sides(effect: EffectConfig, counts: Sequence[int]) -> set[tuple[int, str]]:
    """Return the joints, counted from 0, and sides of an effect; joints have `counts` tendons."""
    wanted = getattr(effect, "tendon", "both")
    return {
        (j, side)
        for j, count in enumerate(counts)
        for side in "ab"[:count]
        if effect.joint in (None, j + 1) and wanted in (side, "both")
    }


def compute_step_max(config: TendonPlantConfig) -> float:
    """Return the largest stable step [s] of a motor loaded by the last step's tension."""
    stiffness = 1.0 / float(build_chain(config.sheath, 0.0).compliance[0])
    return math.sqrt(build_motor(config.motor, 0.0).mass / stiffness)


def remove_obstacles(config: SimulatedRigConfig) -> SimulatedRigConfig:
    """Return the rig with nothing there that its joints and tips could touch."""
    return dataclasses.replace(
        config,
        joints=tuple(dataclasses.replace(j, environment=FreeConfig()) for j in config.joints),
        arms=tuple(dataclasses.replace(arm, contacts=()) for arm in config.arms),
    )


def build_joint(config: JointConfig, pretensions: Sequence[float] = ()) -> Joint:
    """Return the plant of one joint; `pretensions` [N] of its tendons are those of its body."""
    pulls = pretensions or [config.body.pretension] * len(config.tendons)
    tendons = [
        Tendon(build_motor(tendon.motor, pull), Winding(), build_chain(tendon.sheath, pull))
        for tendon, pull in zip(config.tendons, pulls, strict=True)
    ]
    return Joint(
        tendons[0],
        tendons[-1],
        len(tendons) == 2,
        build_body(config.body, len(tendons)),
        build_environment(config.environment),
    )


class Plant(NamedTuple):
    """A rig's joints and sensors, for one compiled call a step; all changed in place."""

    joints: list[Joint]
    states: list[JointState]
    targets: Array  # [m] of the motors, shape (joints, 2)
    places: NDArray[np.int64]  # of the tendons in an array of shape (joints, 2)
    truth: Array  # [N] and [m] in the newest step, shape (4, tendons): `sensor_models.CHANNELS`
    sensors: Sensors
    sensed: SensorState


@jit_compile
def advance_plant(
    plants: list[Plant],
    arm: Arm | None,
    arm_state: Any,
    steps: int,
    dt: float,
    elapsed: float,
    normal: Array,
) -> Array:
    """Advance the first of `plants` by `steps` of `dt` [s]; return what its sensors read then.

    `elapsed` [s] is the time since they were read last, `normal` are standard normal deviates; both
    they and the reading have shape (4, tendons). `arm` is None where no joints share tendons.
    """
    plant = plants[0]
    if arm is None:
        channels = advance_joints(plant.joints, plant.states, plant.targets, steps, dt)
    else:
        channels = advance_arm(arm, plant.joints, plant.states, arm_state, plant.targets, steps, dt)
    truth = plant.truth
    for channel in range(len(truth)):
        for i, place in enumerate(plant.places):
            truth[channel, i] = channels[channel, place // 2, place % 2]
    sensed = measure(plant.sensors, plant.sensed, truth, normal, elapsed)
    plant.sensed.reading[:] = sensed.reading
    plant.sensed.lagged[:] = sensed.lagged
    plant.sensed.travel[:] = sensed.travel
    plant.sensed.rubbed[:] = sensed.rubbed
    return sensed.reading


class SimulatedRig:
    """A `slave.rig.Rig` with bench sensors at the tips.

    Displacements are relative to the start, where every tendon is at its pretension. The same
    config, reads and writes give the same samples. `coarse_reads` were so late that the plant took
    longer steps than its period.
    """

    starts_at_zero = True

    def __init__(self, config: SimulatedRigConfig) -> None:
        self.name = config.name
        self.joints = number_joint_tendons([len(joint.tendons) for joint in config.joints])
        self.tendons = sum(map(len, self.joints))
        self.coarse_reads = 0
        self._period = config.period
        self._step = -1  # index of the newest sample that was read
        self._ahead = False  # whether the plant is one step ahead of it
        self._next: RigSample | None = None  # of that step, unless an effect changes it
        self._targets = targets = np.zeros((len(self.joints), 2))
        self._random = np.random.default_rng(config.seed)
        self._normals: Iterator[Array] = iter(())  # of the next steps
        self._places = np.flatnonzero([[True, len(tendons) == 2] for tendons in self.joints])

        pulls = config.list_pretensions()
        joints = list(map(build_joint, config.joints, pulls))
        self._configured = [joint.environment for joint in config.joints]  # at the ramps' ends
        self._environments = [joint.environment for joint in joints]  # of the plant
        self._ramps: dict[int, EnvironmentRamp] = {}  # by joint
        self._schedules = [
            JointSchedule(config.effects, i, joint) for i, joint in enumerate(joints)
        ]
        start = np.zeros(2)
        joints = [
            schedule.update_joint(0.0, 0.0, start[: len(tendons)]) or joint
            for schedule, joint, tendons in zip(self._schedules, joints, self.joints, strict=True)
        ]
        self._arm: Arm | None = None
        self._arm_state: Any = None  # an ArmState
        if config.arms:
            stiffness = [t.sheath.axial_stiffness for joint in config.joints for t in joint.tendons]
            self._arm = build_arm(config.arms, self.joints, stiffness)
            pretensions = np.zeros_like(targets)
            pretensions.flat[self._places] = [pull for row in pulls for pull in row]
            self._arm_state = init_arm(self._arm, pretensions)
            joints = balance_springs(self._arm, joints, pretensions)
        self._joints = to_compiled_list(joints)
        replace_item(self._joints, 0, joints[0])  # compiles the functions for effects
        self._states = to_compiled_list([init_joint(joint, -config.period) for joint in joints])

        plants = [tendon for joint in config.joints for tendon in joint.tendons]
        self._loops = SensingLoops(
            [tendon.loop for tendon in plants], [tendon.sheath for tendon in plants], config.seed
        )
        sensors = [(tendon.load_cell, tendon.encoder, tendon.motor) for tendon in plants]
        self._sensor_schedule = SensorSchedule(config.effects, self.joints, build_sensors(sensors))
        self._sensors = build_sensors(sensors)
        self._update_sensors(0.0)
        self._truth = np.zeros((len(CHANNELS), self.tendons))
        sensed = init_sensors(self._truth)
        self._plants = to_compiled_list(
            [
                Plant(
                    self._joints,
                    self._states,
                    targets,
                    self._places,
                    self._truth,
                    self._sensors,
                    sensed,
                )
            ]
        )
        self._advance(0, config.period, config.period, np.zeros_like(self._truth))  # the truth
        for values, steady in zip(sensed, init_sensors(self._truth), strict=True):
            values[:] = steady
        self._reading = self._advance(0, config.period, config.period, self._draw_normal())
        self._effects = bool(config.effects)
        self._samples = SampleSchedule(config.effects, config.seed)

    def read(self, time_s: float) -> tuple[RigSample, ...]:
        """Advance the plant to `time_s` [s]; return its newest sample, if new."""
        behind = round(time_s / self._period) - self._step
        if behind <= 0:
            return ()
        if self._ahead:
            self._ahead = False
            self._step += 1
            behind -= 1
        if behind == 0 and self._next is not None:
            return (self._next,)
        if behind > 0:
            self._simulate(behind)
            self._step += behind
        time = self._step * self._period
        if not self._effects:
            return (RigSample(time, *self._reading, *self._loops.readings),)
        reading = self._samples.transmit(time, self._reading)
        return () if reading is None else (RigSample(time, *reading, *self._loops.readings),)

    def advance(self) -> RigSample | None:
        """Compute the next step in advance, with the targets written last."""
        if not self._ahead:
            self._simulate(1)
            self._ahead = True
            if not self._effects:
                time = (self._step + 1) * self._period
                self._next = RigSample(time, *self._reading, *self._loops.readings)
        return self._next

    def write(self, proximal_displacement: Array) -> None:
        """Set the motor targets [m], shape (tendons,)."""
        targets = proximal_displacement.tolist()
        if len(targets) != self.tendons or not all(map(math.isfinite, targets)):
            raise RigFault(f"invalid motor targets {targets}: {self.tendons} finite values needed")
        self._targets.flat[self._places] = proximal_displacement

    def set_environment(self, joint: int, part: int | None, name: str, value: float) -> None:
        """Let a number of an environment go to `value`; see `slave.rig.AdjustableRig`."""
        if joint >= len(self._configured):
            raise ValueError(f"there is no joint {joint}; the rig has {len(self._configured)}")
        goal = replace_number(self._configured[joint], part, name, value)
        self._configured[joint] = goal
        self._ramps[joint] = EnvironmentRamp(self._environments[joint], build_environment(goal))

    def summarise(self) -> dict[str, int | float | str]:
        """Return the number of coarse reads."""
        return {"coarse_reads": self.coarse_reads}

    def close(self) -> None:
        """Do nothing."""

    @property
    def joint_travel(self) -> Array:
        """True travel of each joint [m], shape (joints,)."""
        return np.array([state.travel for state in self._states])

    @property
    def joint_angles(self) -> Array:
        """True angle of each joint of arms [rad], shape (joints,)."""
        return np.asarray(self.joint_travel / self._get_arm().radius)

    @property
    def anchor_tensions(self) -> Array:
        """True tension of each tendon of arms where it ends [N], shape (tendons,)."""
        last = self._get_arm().stretches.ravel()[self._places] - 1
        tension = self._arm_state.tension
        return np.asarray(tension.reshape(-1, tension.shape[-1])[self._places, last])

    @property
    def joint_forces(self) -> Array:
        """True force of all tendons on each joint of arms [N], shape (joints,)."""
        arm, state = self._get_arm(), self._arm_state
        return np.asarray(np.einsum("ksej,kse->j", arm.shortening, state.tension))

    def _get_arm(self) -> Arm:
        if self._arm is None:
            raise ValueError("the rig has no arms")
        return self._arm

    def _simulate(self, behind: int) -> None:
        """Advance the plant and its sensors by `steps` periods."""
        steps, dt = behind, self._period
        if behind > CATCH_UP_STEPS_MAX:
            steps, dt = CATCH_UP_STEPS_MAX, behind * dt / CATCH_UP_STEPS_MAX
            self.coarse_reads += 1
        ramps = self._ramps
        if ramps:  # after a stall they go on from where they were
            dt_ramp = min(behind, CATCH_UP_STEPS_MAX) * self._period
            self._ramps = {i: ramp for i, ramp in ramps.items() if not ramp.advance(dt_ramp)}
        if self._effects:
            self._turn_effects((self._step + behind) * self._period, ramps)
        elapsed = behind * self._period
        self._reading = self._advance(steps, dt, elapsed, self._draw_normal())
        self._loops.advance((self._step + behind) * self._period, steps, dt)

    def _advance(self, steps: int, dt: float, elapsed: float, normal: Array) -> Array:
        return advance_plant(self._plants, self._arm, self._arm_state, steps, dt, elapsed, normal)

    def _draw_normal(self) -> Array:
        normal = next(self._normals, None)
        if normal is None:
            self._normals = iter(self._random.standard_normal((NOISE_STEPS, *self._truth.shape)))
            normal = next(self._normals)
        return normal

    def _update_sensors(self, time: float) -> None:
        sensors = self._sensor_schedule.update_sensors(time)
        for values, changed in zip(self._sensors, sensors or (), strict=False):
            values[:] = changed

    def _turn_effects(self, time: float, changing: Container[int]) -> None:
        for i, (schedule, tendons) in enumerate(zip(self._schedules, self.joints, strict=True)):
            _, housing, _, tip = self._truth[:, tendons]
            joint = schedule.update_joint(time, tip[0], housing, i in changing)
            if joint is not None:
                replace_item(self._joints, i, joint)
                for tendon, part in zip(tendons, joint[:2], strict=False):
                    self._loops.scale_friction(tendon, part.chain.deviations.friction_scale)
        self._update_sensors(time)


# --- text descriptions of effects, and warnings for those that a run did not reach


def describe_effect(effect: EffectConfig) -> str:
    """Return an effect in one line: name, parameters, place and start."""
    values = {field.name: getattr(effect, field.name) for field in dataclasses.fields(effect)}
    name, joint, start = (values.pop(key) for key in ("type", "joint", "start"))
    tendon = values.pop("tendon", "both")
    numbers = ", ".join(f"{key} {value}" for key, value in values.items())
    target = "every joint" if joint is None else f"joint {joint}"
    target += "" if tendon == "both" else f", tendon {tendon}"
    return f"{name} ({numbers}), {target}, from {start:g} s"


def format_late_effects(effects: Sequence[EffectConfig], span: float) -> list[str]:
    """Return a warning for each effect that starts after a run of `span` [s]."""
    return [
        f"WARNING: slave.rig.effects.{i}: {effect.type} starts at {effect.start:g} s, after the "
        f"end at {span:.3g} s: it had no effect"
        for i, effect in enumerate(effects)
        if effect.start >= span
    ]
