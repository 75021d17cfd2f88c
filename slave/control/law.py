"""The control law of a joint: position control between a slack-side and a maximum tension.

The motor target of each tendon follows the joint's travel and the tendon's stretch,

    motor = origin +- (q_cmd - q_cmd,0) + g (e - e_0),        the position law

limited so that the tendon neither goes slack nor exceeds the tension limit:

    motor_last - dx_other + k_slack (T_slack - T) dt  <=  motor
    motor <= motor_last + k_limit (T_max - T) dt

Of a pair, the tendon that the position law pulls drives; the position law of the other would make
it slack, so it follows: feedforward of the travel dx_other of the other's tip, corrected by its own
load cell. All targets are relative to the last gated motor positions, so there is no windup while a
limit is active.

e is the motor's travel less the joint's, which both tendons measure (slave.control.joint).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import copysign, isfinite
from typing import Annotated

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.records import F64, Field, Flag, Struct
from slave.control.joint import fuse_travel
from slave.ranged_field import build_ranged_field, check_ranges
from slave.tendons import SIGNS, EstimatedTendon, EstimatedTendons, JointTendons, RigLayout
from teleop.messages.messages import MAX_JOINTS
from teleop.runtime.clock import STEP_MAX_S

# --- the settings of the tendon controller


@dataclass(frozen=True, slots=True)
class ControlConfig:
    """Controller gains and limits, the same for each tendon of a rig."""

    # g, fraction of the elongation that is compensated; 0 = none
    compensation: float = build_ranged_field(0.95, 0.0, 1.0)
    # at the housing, setpoint of the slack-side tendon
    slack_side_tension: float = build_ranged_field(0.3, 0.0, 50.0, "N")
    # dead band on either side of it
    slack_side_band: float = build_ranged_field(0.05, 0.0, 50.0, "N")
    # gain of the slack-side tension control
    slack_side_gain: float = build_ranged_field(0.020, 0.0, 1.0, "m/s/N")
    # at the housing; set it below the gate's
    tension_max: float = build_ranged_field(20.0, 0.1, 1000.0, "N")
    limit_gain: float = build_ranged_field(0.004, 1e-5, 1.0, "m/s/N")  # gain of the tension limit
    speed_max: float = build_ranged_field(0.050, 1e-4, 10.0, "m/s")  # of a motor's tendon
    # velocity feedforward: lag of the servos
    lead: float = build_ranged_field(0.0125, 0.0, 0.1, "s")

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        check_ranges(self)
        if self.compensation == 1.0:
            raise ValueError("compensation: must be below 1, or a blocked joint is wound up")
        if self.slack_side_band > self.slack_side_tension:
            raise ValueError("slack_side_band: must be at most slack_side_tension")
        if self.slack_side_tension + self.slack_side_band >= self.tension_max:
            raise ValueError("slack_side_tension: must be below tension_max")


class DrivenTendon(Struct):
    """A tendon since its joint engaged."""

    origin: F64 = 0.0  # [m] motor position for no travel and no stretch
    tip: F64 = 0.0  # [m] motor position less elongation, at engagement
    stretch: F64 = 0.0  # [m] motor's travel less the joint's: elongation, by all its tendons
    elongation: F64 = 0.0  # [m] newest valid estimate
    motor: F64 = 0.0  # [m] gated motor position of the last tick


class EngagedJoint(Struct):
    """A joint since it engaged."""

    command: F64 = 0.0  # [m] commanded travel at engagement
    tendon: Annotated[Sequence[DrivenTendon], Field(DrivenTendon, 2)]


class ControllerState(Struct):
    """State of the controller."""

    engaged: Flag = False  # whether `joint` is initialised, from the first engaged tick on
    joint: Annotated[Sequence[EngagedJoint], Field(EngagedJoint, MAX_JOINTS)]


@jit_compile
def step(
    config: ControlConfig,
    layout: RigLayout,
    memory: ControllerState,
    command: Array,
    velocity: Array,
    motor: Array,
    tendons: EstimatedTendons,
    engaged: bool,
    dt: float,
    out_wanted: Array,
) -> None:
    """Advance the controller by one tick: update `memory`, write the motor targets.

    Parameters
    ----------
    layout : RigLayout
        Which tendons each joint has.
    memory : ControllerState
        State, changed in place.
    command : array, shape (MAX_JOINTS,)
        Commanded travel of each joint [m]; used relative to its value at engagement.
    velocity : array, shape (MAX_JOINTS,)
        Of `command` [m/s], for the feedforward; zeros if unknown.
    motor : array, shape (MAX_TENDONS,)
        Last gated motor position of each tendon [m].
    tendons : EstimatedTendons
        The newest sample, shape (tendons,) or longer.
    engaged : bool
        Whether commands are followed. If not, and at the first engaged tick, the targets are the
        present positions.
    dt : float
        Time since the last tick [s].
    out_wanted : array, shape (MAX_TENDONS,)
        Motor targets [m], finite for any input; only those of the rig's tendons are written.
    """
    for i in range(layout.tendons):
        out_wanted[i] = motor[i]
    if not engaged:
        memory.engaged = False
        return
    if not memory.engaged:
        memory.engaged = True
        for k in range(layout.joints):
            _engage_joint(config, layout.joint[k], memory.joint[k], command[k], motor, tendons)
        return
    dt = min(dt, STEP_MAX_S) if dt > 0.0 else 0.0
    for k in range(layout.joints):
        requested = 0.0  # [m] of the joint's tendons, which also pass other joints
        for j in range(layout.joints):
            if layout.ratio[k, j] == 0.0:
                continue
            lead = config.lead * min(max(velocity[j], -config.speed_max), config.speed_max)
            requested += layout.ratio[k, j] * (command[j] - memory.joint[j].command + lead)
        _compute_joint_targets(
            config, layout.joint[k], memory.joint[k], requested, motor, tendons, dt, out_wanted
        )


@jit_compile
def _engage_joint(
    config: ControlConfig,
    joint: JointTendons,
    memory: EngagedJoint,
    command: float,
    motor: Array,
    tendons: EstimatedTendons,
) -> None:
    """Initialise the state of a joint at its present position.

    Without load both position laws would keep the present stretch of their tendons. The origin of
    the tendon with less tension is set back so that both can then be slack.
    """
    memory.command = command
    excess, least = 0.0, 0
    for n in range(joint.count):
        i = joint.tendon[n]
        m, e, tension = motor[i], tendons[i].estimate.elongation, tendons[i].tension
        driven = memory.tendon[n]
        driven.origin = m - config.compensation * e
        driven.tip = _get_position(m, tendons[i]) - e
        driven.stretch = driven.elongation = e
        driven.motor = m
        if tension > config.slack_side_tension:
            excess += e * (1.0 - config.slack_side_tension / tension)
        if tension <= tendons[joint.tendon[least]].tension:
            least = n
    if joint.count > 1:
        memory.tendon[least].origin -= (1.0 - config.compensation) * excess


@jit_compile
def _compute_joint_targets(
    config: ControlConfig,
    joint: JointTendons,
    memory: EngagedJoint,
    requested: float,
    motor: Array,
    tendons: EstimatedTendons,
    dt: float,
    out_wanted: Array,
) -> None:
    """Write the motor targets of a joint with a commanded travel of `requested` [m]."""
    a, b = memory.tendon[0], memory.tendon[1]  # of a joint of one tendon, b stays zero
    e_a, m_a, e_b, m_b = a.elongation, a.motor, b.elongation, b.motor
    _update_joint(joint, memory, motor, tendons)
    # the travel of each tip by its own motor, sign reversed: the other motor has to follow
    follow_b = (a.elongation - e_a) - (a.motor - m_a)
    follow_a = (b.elongation - e_b) - (b.motor - m_b)
    i = joint.tendon[0]
    out_wanted[i] = _compute_target(config, a, SIGNS[0] * requested, follow_a, tendons[i], dt)
    if joint.count > 1:
        i = joint.tendon[1]
        out_wanted[i] = _compute_target(config, b, SIGNS[1] * requested, follow_b, tendons[i], dt)


@jit_compile
def _update_joint(
    joint: JointTendons, memory: EngagedJoint, motor: Array, tendons: EstimatedTendons
) -> None:
    """Update the tendons of a joint with a sample; while one is invalid, their motors only."""
    valid = True
    for n in range(joint.count):
        i = joint.tendon[n]
        memory.tendon[n].motor = motor[i]
        valid = valid and tendons[i].valid
    if not valid:
        return
    a, b = memory.tendon[0], memory.tendon[1]
    i = joint.tendon[0]
    a.elongation = tendons[i].estimate.elongation
    wound_a, wound_b = _get_position(motor[i], tendons[i]) - a.tip, 0.0
    travel_a, travel_b = SIGNS[0] * (wound_a - a.elongation), 0.0
    if joint.count > 1:
        i = joint.tendon[1]
        b.elongation = tendons[i].estimate.elongation
        wound_b = _get_position(motor[i], tendons[i]) - b.tip
        travel_b = SIGNS[1] * (wound_b - b.elongation)
    travel = fuse_travel(joint, tendons, travel_a, travel_b)
    a.stretch = wound_a - SIGNS[0] * travel
    if joint.count > 1:
        b.stretch = wound_b - SIGNS[1] * travel


@jit_compile
def _compute_target(
    config: ControlConfig,
    driven: DrivenTendon,
    requested: float,
    follow: float,
    tendon: EstimatedTendon,
    dt: float,
) -> float:
    """Return the target of a motor [m].

    `requested` [m] is the commanded travel of the tendon's tip since engagement, `follow` [m] how
    far the other tendon's motor has moved the tip since the last tick.
    """
    motor = driven.motor
    wanted = driven.origin + requested + config.compensation * driven.stretch
    least, most = motor + follow, motor
    if tendon.valid:
        error = config.slack_side_tension - tendon.tension
        if abs(error) > config.slack_side_band:
            error -= copysign(config.slack_side_band, error)
            least += config.slack_side_gain * error * dt
        most += config.limit_gain * (config.tension_max - tendon.tension) * dt
    reach = config.speed_max * dt
    bounded = min(max(wanted, least), most, motor + reach)
    return max(bounded, motor - reach) if isfinite(bounded) else motor


@jit_compile
def _get_position(motor: float, tendon: EstimatedTendon) -> float:
    """Return the motor position [m]: measured, or the gated one if there is no encoder."""
    return tendon.displacement if isfinite(tendon.displacement) else motor
