"""The control law of tendons: position control between a slack-side and a maximum tension.

The motor target of each tendon follows the joint's travel and the tendon's stretch,

    motor = origin +- (q_cmd - q_cmd,0) + g (e - e_0),        the position law

limited so that the tendon neither goes slack nor exceeds the tension limit:

    motor_last - dx_other + k_slack (T_slack - T) dt  <=  motor
    motor <= motor_last + k_limit (T_max - T) dt

Of a pair, the tendon that the position law pulls drives; the position law of the other would make
it slack, so it follows: feedforward of the travel dx_other of the other's tip, corrected by its own
load cell. Of n + 1 tendons of n joints, n drive and one follows, by the travel that the others'
tips leave to it (`TendonGroup`). All targets are relative to the last gated motor positions, so
there is no windup while a limit is active.

e is the motor's travel less the tip's, which all tendons measure (slave.control.joint_estimate),
behind a dead band: the compensation integrates, at a tip that sticks, and would hunt by what noise
shows.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import copysign, isfinite
from typing import Annotated

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.noise_treatment import update_play
from estimator.structs import F64, Field, Flag, Struct
from slave.control.joint_estimate import fuse_travels
from slave.rig_layout import EstimatedTendon, EstimatedTendons, RigLayout, TendonGroup
from teleop.config.ranges import build_ranged_field, check_ranges
from teleop.messages.messages import MAX_JOINTS, MAX_TENDONS
from teleop.runtime.clock import STEP_MAX_S

# --- the settings of the tendon controller


@dataclass(frozen=True, slots=True)
class ControlConfig:
    """Controller gains and limits, the same for each tendon of a rig."""

    # g, fraction of the elongation that is compensated; 0 = none
    compensation: float = build_ranged_field(0.95, 0.0, 1.0)
    # dead band on either side of that elongation: a joint that sticks does not hunt
    compensation_band: float = build_ranged_field(2e-6, 0.0, 1e-3, "m")
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
        check_ranges(self)
        if self.compensation == 1.0:
            raise ValueError("compensation: must be below 1, or a blocked joint is wound up")
        if self.slack_side_band > self.slack_side_tension:
            raise ValueError("slack_side_band: must be at most slack_side_tension")
        if self.slack_side_tension + self.slack_side_band >= self.tension_max:
            raise ValueError("slack_side_tension: must be below tension_max")


class DrivenTendon(Struct):
    """A tendon since it engaged."""

    origin: F64 = 0.0  # [m] motor position for no travel and no stretch
    tip: F64 = 0.0  # [m] motor position less elongation, at engagement
    stretch: F64 = 0.0  # [m] motor's travel less the joint's: elongation, by all its tendons
    elongation: F64 = 0.0  # [m] newest valid estimate
    motor: F64 = 0.0  # [m] gated motor position of the last tick


class ControllerState(Struct):
    """State of the controller."""

    engaged: Flag = False  # whether the rest is initialised, from the first engaged tick on
    command: Annotated[Array, Field("f8", MAX_JOINTS)]  # [m] commanded travels at engagement
    tendon: Annotated[Sequence[DrivenTendon], Field(DrivenTendon, MAX_TENDONS)]


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
        for j in range(layout.joints):
            memory.command[j] = command[j]
        for g in range(layout.groups):
            _engage_group(config, layout.group[g], memory, motor, tendons)
        return
    dt = min(dt, STEP_MAX_S) if dt > 0.0 else 0.0
    wound, moved = np.empty(layout.tendons), np.empty(layout.tendons)
    for g in range(layout.groups):
        group = layout.group[g]
        excess = _update_group(config, group, memory, motor, tendons, wound, moved)
        for n in range(group.count):
            i, follow = group.tendon[n], 0.0  # [m] by which motors let the tip travel
            if group.count > 1:  # of a pair, by the other; a common motion of all dies down
                share = group.count / (group.count - 1.0)
                follow = moved[i] - share * group.balance[n] * excess
            requested = 0.0  # [m] of the tip
            for j in range(layout.joints):
                if layout.travel[i, j] != 0.0:
                    lead = config.lead * min(max(velocity[j], -config.speed_max), config.speed_max)
                    requested += layout.travel[i, j] * (command[j] - memory.command[j] + lead)
            out_wanted[i] = _compute_target(
                config, memory.tendon[i], requested, follow, tendons[i], dt
            )


@jit_compile
def _engage_group(
    config: ControlConfig,
    group: TendonGroup,
    memory: ControllerState,
    motor: Array,
    tendons: EstimatedTendons,
) -> None:
    """Initialise the state of tendons at their present position.

    Without load all position laws would keep the present stretch of their tendons. The origin of
    the tendon with the least tension is set back so that all can then be slack.
    """
    excess, least = 0.0, 0
    for n in range(group.count):
        i = group.tendon[n]
        m, e, tension = motor[i], tendons[i].estimate.elongation, tendons[i].tension
        driven = memory.tendon[i]
        driven.origin = m - config.compensation * e
        driven.tip = _get_position(m, tendons[i]) - e
        driven.stretch = driven.elongation = e
        driven.motor = m
        if tension > config.slack_side_tension:
            excess += group.balance[n] * e * (1.0 - config.slack_side_tension / tension)
        if tension <= tendons[group.tendon[least]].tension:
            least = n
    if group.count > 1:
        driven = memory.tendon[group.tendon[least]]
        driven.origin -= (1.0 - config.compensation) * excess / group.balance[least]


@jit_compile
def _update_group(
    config: ControlConfig,
    group: TendonGroup,
    memory: ControllerState,
    motor: Array,
    tendons: EstimatedTendons,
    wound: Array,
    out_moved: Array,
) -> float:
    """Update tendons with a sample; while one is invalid, their motors only.

    Writes how far each motor has moved its tip [m] since the last tick, and returns how far from
    balance these are: sum t_i moved_i / sum t_i^2. `wound` is a work array.
    """
    valid = True
    for n in range(group.count):
        i = group.tendon[n]
        driven = memory.tendon[i]
        out_moved[i] = motor[i] - driven.motor
        driven.motor = motor[i]
        valid = valid and tendons[i].valid
    excess, scale = 0.0, 0.0
    for n in range(group.count):
        i, t = group.tendon[n], group.balance[n]
        driven, elongation = memory.tendon[i], tendons[i].estimate.elongation
        if not valid:
            elongation = driven.elongation
        out_moved[i] -= elongation - driven.elongation
        driven.elongation = elongation
        excess += t * out_moved[i]
        scale += t * t
        wound[i] = _get_position(motor[i], tendons[i]) - driven.tip - elongation
    if valid:
        fuse_travels(group, tendons, wound)
    for n in range(group.count if valid else 0):
        i = group.tendon[n]
        driven = memory.tendon[i]
        stretch = _get_position(motor[i], tendons[i]) - driven.tip - wound[i]
        driven.stretch = update_play(driven.stretch, stretch, config.compensation_band)
    return excess / scale


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
    far the other tendons' motors have moved the tip since the last tick.
    """
    motor = driven.motor
    wanted = driven.origin + requested + config.compensation * driven.stretch
    lowest, highest = motor + follow, motor
    if tendon.valid:
        error = config.slack_side_tension - tendon.tension
        if abs(error) > config.slack_side_band:
            error -= copysign(config.slack_side_band, error)
            lowest += config.slack_side_gain * error * dt
        highest += config.limit_gain * (config.tension_max - tendon.tension) * dt
    reach = config.speed_max * dt
    bounded = min(max(wanted, lowest), highest, motor + reach)
    return max(bounded, motor - reach) if isfinite(bounded) else motor


@jit_compile
def _get_position(motor: float, tendon: EstimatedTendon) -> float:
    """Return the motor position [m]: measured, or the gated one if there is no encoder."""
    return tendon.displacement if isfinite(tendon.displacement) else motor
