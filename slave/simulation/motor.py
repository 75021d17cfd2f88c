"""The motor that winds a tendon: a geared DC servo with its own position control.

In units of the tendon: travel [m] at the pulley, force [N], rotor inertia as a mass.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from estimator.compiled import jit_compile
from teleop.config.ranges import RangedConfig, build_ranged_field


@dataclass(frozen=True, slots=True)
class MotorConfig(RangedConfig):
    """A servo like that of Phee et al. 2009: Faulhaber 2642 W 024 CR with gearhead 30/1 S.

    The paper gives the two names and the ratio. The other figures are typical of a 24 V motor of
    this size and mutually consistent, but not checked against the data sheet. Entries marked * are
    assumptions. Set those of your motor.
    """

    pulley_radius: float = build_ranged_field(0.010, 1e-4, 1.0, "m")  # at the gear's output *
    gear: float = build_ranged_field(134.0, 1e-3, 1e5)  # turns of the motor for one of the pulley
    efficiency: float = build_ranged_field(0.60, 1e-2, 1.0)  # of the gear, three stages of planets
    # of the gear, at its output; such a gear has about 0.02
    backlash: float = build_ranged_field(0.0, 0.0, 1.0, "rad")
    no_load_speed: float = build_ranged_field(670.0, 1e-2, 1e5, "rad/s")  # of the motor
    # of the motor, at rated voltage
    stall_torque: float = build_ranged_field(0.139, 1e-6, 1e3, "N m")
    # of the motor, as its driver limits the current *
    peak_torque: float = build_ranged_field(0.075, 1e-6, 1e3, "N m")
    rated_torque: float = build_ranged_field(0.028, 1e-6, 1e3, "N m")  # of the motor, continuous
    # thermal time constant of the winding *
    thermal_time: float = build_ranged_field(10.0, 1e-3, 1e5, "s")
    rotor_inertia: float = build_ranged_field(1.1e-6, 1e-10, 1.0, "kg m^2")  # of the motor
    # of the position loop *; its speed loop is 4 times faster
    bandwidth: float = build_ranged_field(100.0, 0.1, 1e4, "rad/s")


class Motor(NamedTuple):
    """A motor's constants in units of the tendon."""

    mass: float  # [kg] of the rotor, through the gear
    speed_max: float  # [m/s] without load
    force_stall: float  # [N] at standstill and rated voltage
    force_peak: float  # [N]
    force_rated: float  # [N]
    thermal_time: float  # [s]
    position_gain: float  # [1/s]
    speed_gain: float  # [1/s]
    backlash: float  # [m] of tendon
    pulley_radius: float  # [m]
    hold: float  # [N] that balances the tendon at the start, with the motor at zero


class MotorState(NamedTuple):
    """State of a motor."""

    position: float  # [m] of tendon, at the encoder
    speed: float  # [m/s]
    heat: float  # mean square of the force, over the rated force's
    pulley: float  # [m] of tendon, wound in by the pulley


def build_motor(config: MotorConfig, pretension: float) -> Motor:
    """Return the motor that `config` describes; the tendon starts at `pretension` [N]."""
    travel = config.pulley_radius / config.gear  # [m] per rad of the motor
    return Motor(
        mass=config.rotor_inertia / travel**2,
        speed_max=config.no_load_speed * travel,
        force_stall=config.stall_torque * config.efficiency / travel,
        force_peak=config.peak_torque * config.efficiency / travel,
        force_rated=config.rated_torque * config.efficiency / travel,
        thermal_time=config.thermal_time,
        position_gain=config.bandwidth,
        speed_gain=4.0 * config.bandwidth,
        backlash=config.backlash * config.pulley_radius,
        pulley_radius=config.pulley_radius,
        hold=pretension,
    )


def init_motor() -> MotorState:
    """Return the state of a motor at its zero."""
    return MotorState(0.0, 0.0, 0.0, 0.0)


@jit_compile
def advance_motor(
    motor: Motor, state: MotorState, target: float, tension: float, dt: float
) -> MotorState:
    """Advance by `dt` [s] towards `target` [m] while the tendon pulls with `tension` [N].

    mass v' = F - tension;  F = mass speed_gain (v_wanted - v) + hold,
    v_wanted = position_gain (target - position) within the no-load speed,

    critically damped as speed_gain is 4 position_gain; F within what voltage (stall force at rest,
    none at no-load speed) and current allow: the peak force, or the rated one once the winding is
    warm. Implicit Euler, stable for any step.
    """
    mass, gain = motor.mass, motor.speed_gain
    pushed = state.speed - dt * tension / mass
    base_speed = pushed + dt * motor.hold / mass
    error = motor.position_gain * (target - state.position)
    speed = (base_speed + dt * gain * error) / (1.0 + dt * gain * (1.0 + dt * motor.position_gain))
    setpoint = error - motor.position_gain * dt * speed
    if abs(setpoint) > motor.speed_max:
        speed = (base_speed + dt * gain * math.copysign(motor.speed_max, setpoint)) / (
            1.0 + dt * gain
        )
    kick = dt * motor.force_stall / mass
    drag = 1.0 + kick / motor.speed_max
    speed = min(max(speed, (pushed - kick) / drag), (pushed + kick) / drag)
    kick = dt * (motor.force_peak if state.heat < 1.0 else motor.force_rated) / mass
    speed = min(max(speed, pushed - kick), pushed + kick)
    load = ((speed - pushed) * mass / dt / motor.force_rated) ** 2
    heat = state.heat + (load - state.heat) * (1.0 - math.exp(-dt / motor.thermal_time))
    position = state.position + dt * speed
    pulley = position
    if tension <= 0.0:
        pulley = min(max(state.pulley, position), position + motor.backlash)
    return MotorState(position, speed, heat, pulley)
