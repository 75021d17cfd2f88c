"""The control law of a joint: position, between a loose and a full tension.

Each tendon's motor is wanted where the joint's travel and the tendon's stretch ask for it,

    motor = origin +- (q_asked - q_asked,0) + g (e - e_0),        the position law

but never so far out that the tendon goes slack, nor so far in that its tension passes the limit:

    motor_last - dx_other + k_loose (T_loose - T) dt  <=  motor
    motor <= motor_last + k_limit (T_max - T) dt

Of a pair, the tendon that the position law pulls drives; the position law of the other asks for
less than the least tension, so it follows: fed forward by the travel dx_other of the other's tip,
corrected by its own load cell. As everything is said from where the motors were last let go to,
nothing winds up while a limit holds.

e is the motor's travel less the joint's, and that is told by both tendons (slave.control.joint).
"""

from collections.abc import Sequence
from math import copysign, isfinite
from typing import NamedTuple

from slave.control.config import ControlConfig
from slave.control.joint import SIGNS, TendonSeen, fused

DT_MAX = 0.005  # [s] however long a tick was skipped, a motor may go no further than this allows


class Driven(NamedTuple):
    """A tendon since its joint engaged."""

    origin: float  # [m] motor position for no travel and no stretch
    tip: float  # [m] motor position less elongation, at engagement
    stretch: float  # [m] motor's travel less the joint's: elongation, as told by all its tendons
    elongation: float  # [m] newest estimate that could be relied upon
    motor: float  # [m] where the motor was let go at the tick before


class Engaged(NamedTuple):
    """A joint since it engaged."""

    command: float  # [m] travel asked for at engagement
    tendons: tuple[Driven, ...]


class Control(NamedTuple):
    """Memory of the controller: its joints, none until the session engages."""

    joints: tuple[Engaged, ...] = ()


def step(
    config: ControlConfig,
    joints: Sequence[Sequence[int]],
    memory: Control,
    command: Sequence[float],
    motor: Sequence[float],
    tendons: Sequence[TendonSeen],
    engaged: bool,
    dt: float,
    velocity: Sequence[float] = (),
) -> tuple[tuple[float, ...], Control]:
    """Return the motor positions wanted [m], finite whatever comes in, and the new memory.

    Parameters
    ----------
    config : ControlConfig
        Gains and limits.
    joints : sequence of sequences of int
        Which tendons each joint has, `Rig.joints`.
    command : sequence of float
        Travel asked of each joint [m]; what counts is how it changes from engagement on.
    motor : sequence of float
        Motor position the gate last let through [m], for each tendon.
    tendons : sequence of TendonSeen
        The newest sample.
    engaged : bool
        Whether commands count. While they do not, and at the tick at which they begin to, the
        motors are wanted where they are.
    dt : float
        Time since the last tick [s].
    velocity : sequence of float
        Of `command` [m/s], to make up for the servos' lag; none, and they lag.
    """
    if not engaged:
        return tuple(motor), Control()
    if not memory.joints:
        start = [
            _engage(config, joint, asked, motor, tendons)
            for joint, asked in zip(joints, command, strict=True)
        ]
        return tuple(motor), Control(tuple(start))
    dt = min(dt, DT_MAX) if dt > 0.0 else 0.0
    wanted, after = list(motor), []
    for k, joint in enumerate(joints):
        command_0, before = memory.joints[k]
        speed = velocity[k] if velocity else 0.0
        asked = command[k] - command_0
        asked += config.lead * min(max(speed, -config.speed_max), config.speed_max)
        driven = _told(before, joint, motor, tendons)
        for n, i in enumerate(joint):
            follow = 0.0
            if len(joint) > 1:
                was, now = before[1 - n], driven[1 - n]
                follow = (now.elongation - was.elongation) - (now.motor - was.motor)
            wanted[i] = _target(config, driven[n], SIGNS[n] * asked, follow, tendons[i], dt)
        after.append(Engaged(command_0, driven))
    return tuple(wanted), Control(tuple(after))


def _engage(
    config: ControlConfig,
    joint: Sequence[int],
    command: float,
    motor: Sequence[float],
    tendons: Sequence[TendonSeen],
) -> Engaged:
    """Return the memory of a joint that stays where it is.

    Without load both position laws would keep the stretch that their tendons have now. That of the
    tendon with less tension is set back by what lets both be loose then.
    """
    driven, excess, least = [], 0.0, 0
    for n, i in enumerate(joint):
        m, e, tension = motor[i], tendons[i].elongation, tendons[i].tension
        origin = m - config.compensation * e
        driven.append(Driven(origin, _position(m, tendons[i]) - e, e, e, m))
        if tension > config.loose_tension:
            excess += e * (1.0 - config.loose_tension / tension)
        if tension <= tendons[joint[least]].tension:
            least = n
    if len(driven) > 1:
        back = (1.0 - config.compensation) * excess
        driven[least] = driven[least]._replace(origin=driven[least].origin - back)
    return Engaged(command, tuple(driven))


def _told(
    driven: tuple[Driven, ...],
    joint: Sequence[int],
    motor: Sequence[float],
    tendons: Sequence[TendonSeen],
) -> tuple[Driven, ...]:
    """Return the tendons of a joint with the news of a sample; while one is invalid, no news."""
    told = [tendons[i] for i in joint]
    wound, travels = [], []
    for n, tendon in enumerate(told):
        if not tendon.valid:
            return tuple(old._replace(motor=motor[i]) for old, i in zip(driven, joint, strict=True))
        wound.append(_position(motor[joint[n]], tendon) - driven[n].tip)
        travels.append(SIGNS[n] * (wound[n] - tendon.elongation))
    travel = fused(travels, told)
    after = []
    for n, (origin, tip, *_) in enumerate(driven):
        stretch = wound[n] - SIGNS[n] * travel
        after.append(Driven(origin, tip, stretch, told[n].elongation, motor[joint[n]]))
    return tuple(after)


def _target(
    config: ControlConfig,
    driven: Driven,
    asked: float,
    follow: float,
    tendon: TendonSeen,
    dt: float,
) -> float:
    """Return where a motor is wanted [m].

    `asked` [m] is the travel asked of the tendon's tip since engagement, `follow` [m] how far the
    tip has been moved by the other tendon's motor since the last tick.
    """
    motor = driven.motor
    wanted = driven.origin + asked + config.compensation * driven.stretch
    least, most = motor + follow, motor
    if tendon.valid:
        error = config.loose_tension - tendon.tension
        if abs(error) > config.loose_band:
            error -= copysign(config.loose_band, error)
            least += config.loose_gain * error * dt
        most += config.limit_gain * (config.tension_max - tendon.tension) * dt
    reach = config.speed_max * dt
    bounded = min(max(wanted, least), most, motor + reach)
    return max(bounded, motor - reach) if isfinite(bounded) else motor


def _position(motor: float, tendon: TendonSeen) -> float:
    """Return where a motor is [m]: as measured, or as it was let go where nothing measures it."""
    return tendon.displacement if isfinite(tendon.displacement) else motor
