"""Environments of a joint: free, wall, soft tissue, load motor, or several of these.

A joint's position q is the travel of its tendons at the joint [m], positive in the pulling
direction of tendon `a`; a positive force opposes that. The force of every environment is
non-decreasing in q within a step, so a joint's balance has one solution.
"""

from dataclasses import dataclass, field, replace
from math import inf
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.compiled import jit_compile
from teleop.config.ranges import MAY_BE_INFINITE, RangedConfig, build_ranged_field, check_ranges

IntArray = NDArray[np.int64]

STIFFNESS_MAX = 1e7  # [N/m] a thousand times a tendon's own; above it rounding shows in the force
TRAVEL_MAX = 1.0  # [m]
SLEW_S = 0.5  # [s] in which a changed number of a running rig reaches its new value

WALL, TISSUE, FORCE, POSITION = range(4)


@dataclass(frozen=True, slots=True)
class FreeConfig:
    """No contact."""

    type: Literal["free"] = "free"


@dataclass(frozen=True, slots=True)
class WallConfig(RangedConfig):
    """A stiff wall: F = stiffness d + damping d', never pulling, with penetration d.

    The pull of tendon `side` moves the joint into it.
    """

    type: Literal["wall"] = "wall"
    # of the joint at first contact
    position: float = build_ranged_field(0.008, -TRAVEL_MAX, TRAVEL_MAX, "m")
    stiffness: float = build_ranged_field(20_000.0, 0.0, STIFFNESS_MAX, "N/m")  # of the wall
    damping: float = build_ranged_field(0.0, 0.0, 1e5, "N s/m")  # of the wall
    side: Literal["a", "b"] = "a"  # tendon whose pull moves the joint into it


@dataclass(frozen=True, slots=True)
class TissueConfig(RangedConfig):
    """Soft tissue, F = stiffness d^exponent (1 + dissipation d'), never pulling.

    The contact law of Hunt and Crossley, "Coefficient of Restitution Interpreted as Damping in
    Vibroimpact", J. Appl. Mech. 42 (1975) 440-445. By default Hertz's contact of a ball of 5 mm
    radius with a firm organ of 100 kPa, 4/3 E sqrt(R): 3.3 N at 5 mm. Liver would be a tenth.
    """

    type: Literal["tissue"] = "tissue"
    # of the joint at first contact
    position: float = build_ranged_field(0.008, -TRAVEL_MAX, TRAVEL_MAX, "m")
    stiffness: float = build_ranged_field(9_400.0, 0.0, 1e9, "N/m^exponent")  # of the contact
    exponent: float = build_ranged_field(1.5, 1.0, 4.0)  # of the depth
    # by which the force grows with speed
    dissipation: float = build_ranged_field(1.0, 0.0, 1e4, "s/m")
    side: Literal["a", "b"] = "a"  # tendon whose pull moves the joint into it


@dataclass(frozen=True, slots=True)
class LoadMotorConfig:
    """A load motor on the joint, as on the bench of Phee et al. 2009, that follows a profile.

    Under torque control the profile is its force; under position control it is its position,
    coupled to the joint by a stiffness. The profile is piecewise linear; outside its points the
    value is constant, or periodic if it repeats. While the motor is not coupled its force is zero.
    """

    type: Literal["load_motor"] = "load_motor"
    mode: Literal["torque", "position"] = "torque"  # what the profile is: force, or position
    profile: tuple[tuple[float, float], ...] = ((0.0, 0.0),)  # [[s, N or m], ...], time increasing
    # of the coupling, under position control
    stiffness: float = build_ranged_field(5000.0, 0.0, STIFFNESS_MAX, "N/m")
    repeat: bool = False  # start the profile again after its last point
    # [s] from, to
    coupled: tuple[float, float] = field(default=(0.0, inf), metadata=MAY_BE_INFINITE)

    def __post_init__(self) -> None:
        check_ranges(self)
        if not 0.0 <= self.coupled[0] < self.coupled[1]:
            raise ValueError("coupled: must be two times, the second after the first")
        if not self.profile:
            raise ValueError("profile: at least one point is needed")
        for i, (time, value) in enumerate(self.profile):
            if not 0.0 <= time <= 1e6 or (i > 0 and time <= self.profile[i - 1][0]):
                raise ValueError("profile: times must increase, from 0 s or later")
            limit = 1000.0 if self.mode == "torque" else TRAVEL_MAX
            if not abs(value) <= limit:
                unit = "N" if self.mode == "torque" else "m"
                raise ValueError(f"profile: values must be -{limit:g} to {limit:g} {unit}")


SingleEnvironmentConfig = FreeConfig | WallConfig | TissueConfig | LoadMotorConfig


@dataclass(frozen=True, slots=True)
class CombinedEnvironmentConfig:
    """Several environments whose forces add up: tissue before a wall, walls on both sides."""

    type: Literal["several"] = "several"
    parts: tuple[SingleEnvironmentConfig, ...] = ()  # the environments


EnvironmentConfig = SingleEnvironmentConfig | CombinedEnvironmentConfig


class Environment(NamedTuple):
    """An environment for compiled functions: one row per part."""

    kind: IntArray  # WALL, TISSUE, FORCE or POSITION, shape (parts,)
    constants: Array  # shape (parts, 7): position, stiffness, damping, exponent, side, from, to
    points: Array  # shape (all points, 2): the profiles of all parts, one after another
    extent: IntArray  # shape (parts, 3): first and past-the-end point of a part; whether it repeats


def build_environment(config: EnvironmentConfig) -> Environment:
    """Return the environment that `config` describes."""
    if isinstance(config, CombinedEnvironmentConfig):
        environment = build_empty_environment()
        for part in config.parts:
            environment = merge_environments(environment, build_environment(part))
        return environment
    if isinstance(config, FreeConfig):
        return build_empty_environment()
    if isinstance(config, LoadMotorConfig):
        kind = FORCE if config.mode == "torque" else POSITION
        constants = (0.0, config.stiffness, 0.0, 1.0, 1.0, *config.coupled)
        points, repeat = np.array(config.profile), config.repeat
    else:
        side = 1.0 if config.side == "a" else -1.0
        if isinstance(config, WallConfig):
            kind, damping, exponent = WALL, config.damping, 1.0
        else:
            kind, damping, exponent = TISSUE, config.dissipation, config.exponent
        constants = (config.position, config.stiffness, damping, exponent, side, 0.0, inf)
        points, repeat = np.empty((0, 2)), False
    return Environment(
        np.array([kind]), np.array([constants]), points, np.array([[0, len(points), repeat]])
    )


def merge_environments(first: Environment, second: Environment) -> Environment:
    """Return an environment with the parts of both."""
    extent = second.extent + np.array([len(first.points), len(first.points), 0])
    return Environment(
        np.concatenate([first.kind, second.kind]),
        np.concatenate([first.constants, second.constants]),
        np.concatenate([first.points, second.points]),
        np.concatenate([first.extent, extent]),
    )


# columns of `Environment.constants` that a running rig may change, by their names in a config
_COLUMNS = {"position": 0, "stiffness": 1, "damping": 2, "dissipation": 2}


def replace_number(
    config: EnvironmentConfig, part: int | None, name: str, value: float
) -> EnvironmentConfig:
    """Return an environment with another `name` of its config, or of one of its parts.

    Raises `ValueError`.
    """
    if part is None:
        if name not in _COLUMNS or not hasattr(config, name):
            raise ValueError(f"an environment of type {config.type} has no such number")
        values: dict[str, Any] = {name: value}
        return replace(config, **values)
    if not isinstance(config, CombinedEnvironmentConfig) or part >= len(config.parts):
        raise ValueError(f"an environment of type {config.type} has no part {part}")
    parts: list[Any] = list(config.parts)
    parts[part] = replace_number(parts[part], None, name, value)
    return replace(config, parts=tuple(parts))


class EnvironmentRamp:
    """The constants of an environment on their way to those of another one of the same parts.

    Those of `environment` are changed in place; `goal` has as many parts, of the same kinds.
    """

    def __init__(self, environment: Environment, goal: Environment) -> None:
        self._constants, self._goal = environment.constants, goal.constants
        self._start, self._passed = environment.constants.copy(), 0.0

    def advance(self, dt: float) -> bool:
        """Go on by `dt` [s]; return whether the goal, `SLEW_S` after the start, is reached."""
        self._passed += dt
        if self._passed >= SLEW_S:
            self._constants[:] = self._goal
            return True
        changed = self._start != self._goal  # infinite times stay as they are
        gap = self._goal[changed] - self._start[changed]
        self._constants[changed] = self._start[changed] + gap * (self._passed / SLEW_S)
        return False


@jit_compile
def build_empty_environment() -> Environment:
    """Return an environment without parts."""
    return Environment(
        np.empty(0, np.int64), np.empty((0, 7)), np.empty((0, 2)), np.empty((0, 3), np.int64)
    )


@jit_compile
def interpolate_profile(environment: Environment, part: int, time: float) -> float:
    """Return the value of a part's profile at `time` [s]: linear between its points."""
    first, end, repeats = environment.extent[part]
    points = environment.points
    start, span = points[first, 0], points[end - 1, 0] - points[first, 0]
    if repeats and span > 0.0 and time > start:
        time = start + (time - start) % span
    if time <= start:
        return float(points[first, 1])
    for i in range(first + 1, end):
        if time < points[i, 0]:
            share = (time - points[i - 1, 0]) / (points[i, 0] - points[i - 1, 0])
            return float(points[i - 1, 1] + share * (points[i, 1] - points[i - 1, 1]))
    return float(points[end - 1, 1])


@jit_compile
def compute_environment_force(
    environment: Environment, travel: float, start: float, time: float, dt: float
) -> float:
    """Return the force [N] at `travel` [m], reached in `dt` [s] from `start` [m] at `time` [s].

    Penetration rates use only the part of the travel inside the contact, so the force is continuous
    at first contact.
    """
    force = 0.0
    for part in range(len(environment.kind)):
        kind = environment.kind[part]
        position, stiffness, damping, exponent, side, begin, end = environment.constants[part]
        if not begin <= time < end:
            continue
        if kind == FORCE:
            force += interpolate_profile(environment, part, time)
        elif kind == POSITION:
            force += stiffness * (travel - interpolate_profile(environment, part, time))
        else:
            depth = side * (travel - position)
            if depth > 0.0:
                rate = (depth - max(0.0, side * (start - position))) / dt
                if kind == WALL:
                    force += side * max(0.0, stiffness * depth + damping * rate)
                else:
                    force += side * stiffness * depth**exponent * max(0.0, 1.0 + damping * rate)
    return force
