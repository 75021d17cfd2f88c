"""A simulated hand: a scripted reference, and a mass-spring-damper that responds to the force.

The hand and the handle in it are a mass that the arm pulls along a reference through a spring and a
damper, and that the device pushes:

    m x'' = k (x_ref - x) + b (x_ref' - x') + F

Second order is the usual model of an arm that holds a haptic handle (Speich, Shao & Goldfarb 2005).
The defaults are of the order of a relaxed to moderate grip, not measured.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Literal

from master.device import Axes, HandState, require_force
from teleop.config.ranges import MAY_BE_INFINITE, build_ranged_field, check_ranges

# --- reference motions of a scripted hand: position and velocity as functions of time


@dataclass(frozen=True, slots=True)
class Hold:
    """A hand that stays where it is."""

    type: Literal["hold"] = "hold"
    position: float = 0.0  # [m] where it stays

    def __post_init__(self) -> None:
        if not math.isfinite(self.position):
            raise ValueError("position: must be finite [m]")

    def compute_motion(self, time_s: float) -> tuple[float, float]:  # noqa: ARG002 - one signature for all
        """Return position [m] and velocity [m/s]."""
        return self.position, 0.0


@dataclass(frozen=True, slots=True)
class Sine:
    """A sine: x = offset + amplitude * sin(2 pi frequency t)."""

    type: Literal["sine"] = "sine"
    amplitude: float = build_ranged_field(0.02, 0.0, 1.0, "m")  # of the motion
    # people move freely up to about 5 Hz
    frequency: float = build_ranged_field(0.5, 0.0, 20.0, "Hz")
    offset: float = 0.0  # [m] middle of the motion

    def __post_init__(self) -> None:
        check_ranges(self)
        if not math.isfinite(self.offset):
            raise ValueError("offset: must be finite [m]")

    def compute_motion(self, time_s: float) -> tuple[float, float]:
        """Return position [m] and velocity [m/s]."""
        rate = 2.0 * math.pi * self.frequency
        angle = rate * time_s
        return (
            self.offset + self.amplitude * math.sin(angle),
            self.amplitude * rate * math.cos(angle),
        )


@dataclass(frozen=True, slots=True)
class Reaches:
    """Cyclic minimum-jerk reaches from target to target, each followed by a rest.

    Over a reach from a to b, with s = t / reach: x = a + (b - a) (10 s^3 - 15 s^4 + 6 s^5)
    (Flash & Hogan 1985). The first reach starts at zero.
    """

    type: Literal["reaches"] = "reaches"
    # [m] one after the other; by default with nested reversals
    targets: tuple[float, ...] = (0.0, 0.05, 0.02, 0.04, 0.01, 0.055)
    reach: float = build_ranged_field(0.8, 0.0, math.inf, "s", above=True)  # duration of each reach
    rest: float = build_ranged_field(0.3, 0.0, math.inf, "s")  # at each target

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.targets or not all(math.isfinite(target) for target in self.targets):
            raise ValueError("targets: at least one, all finite [m]")

    def compute_motion(self, time_s: float) -> tuple[float, float]:
        """Return position [m] and velocity [m/s]."""
        count, within = divmod(max(time_s, 0.0), self.reach + self.rest)
        number = int(count)
        goal = self.targets[number % len(self.targets)]
        start = self.targets[(number - 1) % len(self.targets)] if number else 0.0
        s = min(within / self.reach, 1.0)
        way = s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
        speed = 30.0 * s * s * (1.0 - s) * (1.0 - s) / self.reach
        return start + (goal - start) * way, (goal - start) * speed


@dataclass(frozen=True, slots=True)
class Waypoints:
    """Cyclic reaches from point to point, as `Reaches` but of all axes together."""

    type: Literal["waypoints"] = "waypoints"
    # [m], or [rad] of an axis that turns; a number for each axis, the first reach is from zero
    points: tuple[tuple[float, ...], ...] = ((0.0,), (0.02,))
    reach: float = 0.8  # [s] duration of each reach
    rest: float = 0.3  # [s] at each point

    def __post_init__(self) -> None:
        if not self.points or len({len(point) for point in self.points}) != 1:
            raise ValueError("points: at least one, all with a number for each axis")
        for axis in range(len(self.points[0])):
            self.select_axis(axis)

    def compute_motion(self, time_s: float) -> tuple[float, float]:
        """Return position [m] and velocity [m/s] of the first axis."""
        return self.select_axis(0).compute_motion(time_s)

    def select_axis(self, axis: int) -> Reaches:
        """Return the motion of one axis."""
        return Reaches(
            "reaches", tuple(point[axis] for point in self.points), self.reach, self.rest
        )


Reference = Hold | Sine | Reaches | Waypoints

_SUBSTEP = 0.001  # [s] step of the integration; up to half as long again, to fit the gap
_SUBSTEPS_MAX = 1000  # a longer gap is crossed in this many steps, however long
_WATCHDOG = 0.05  # [s] without a write after which the device lets go of the force


@dataclass(frozen=True, slots=True)
class VirtualConfig:
    """A scripted hand."""

    type: Literal["virtual"] = "virtual"
    axes: int = build_ranged_field(1, 1, 8)  # joints that it moves
    # by which each further axis follows the script later
    axis_delay: float = build_ranged_field(0.25, 0.0, math.inf, "s")
    mass: float = build_ranged_field(0.3, 0.001, 100.0, "kg")  # hand and handle
    stiffness: float = build_ranged_field(300.0, 0.0, 1e5, "N/m")  # of the arm about its reference
    damping: float = build_ranged_field(10.0, 0.0, 1e4, "N s/m")  # of the arm
    reference: Reference = field(default_factory=Reaches)  # motion of the hand
    engage: tuple[tuple[float, float], ...] = field(  # [s] the switch is held from ... to ...
        default=((0.5, math.inf),), metadata=MAY_BE_INFINITE
    )
    # after which `engage` starts over
    engage_period: float = build_ranged_field(math.inf, 0.0, math.inf, "s", above=True)

    def __post_init__(self) -> None:
        check_ranges(self)
        if isinstance(self.reference, Waypoints) and len(self.reference.points[0]) != self.axes:
            raise ValueError(f"reference.points: must have {self.axes} numbers each, as axes says")
        times = [time for span in self.engage for time in span]
        if times != sorted(times) or any(math.isnan(t) or t < 0.0 for t in times):
            raise ValueError("engage: pairs [from, to] in seconds, in order, not overlapping")

    @property
    def axis_count(self) -> int:
        """How many joints it moves."""
        return self.axes

    def select_axis(self, axis: int) -> tuple["VirtualConfig", Hold | Sine | Reaches, float]:
        """Return the config of one axis, its script, and its delay [s]."""
        if not isinstance(self.reference, Waypoints):
            return self, self.reference, axis * self.axis_delay
        script = self.reference.select_axis(axis)
        return replace(self, axes=1, reference=script), script, 0.0

    def is_pressed(self, time_s: float) -> bool:
        """Return whether the hand holds the engage switch at `time_s` [s]."""
        within = time_s % self.engage_period
        return any(start <= within < end for start, end in self.engage)


def advance_hand(
    config: VirtualConfig, position: float, velocity: float, time_s: float, force: float, h: float
) -> tuple[float, float]:
    """Return position [m] and velocity [m/s] of one axis at `time_s`, `h` [s] after those given.

    Backward Euler: stable for any `h`, and it never adds energy of its own, so an oscillation of
    the loop is not one of the integration.
    """
    k, b = config.stiffness, config.damping
    target, target_velocity = config.reference.compute_motion(time_s)
    pull = k * (target - position) + b * target_velocity + force
    velocity = (config.mass * velocity + h * pull) / (config.mass + h * b + h * h * k)
    return position + h * velocity, velocity


class VirtualDevice:
    """A `master.device.Device` moved by a scripted hand; see the module's text.

    `applied` [N] is the force on the hand at the last read: the last one written, or zero once the
    watchdog has let go of it.
    """

    def __init__(self, config: VirtualConfig) -> None:
        self.axes = config.axes
        self.applied: Axes = (0.0,) * config.axes
        self._config = config
        self._axes = [config.select_axis(axis) for axis in range(config.axes)]
        self._time = 0.0
        self._written = -math.inf
        self._force = self.applied
        self._hands = [script.compute_motion(-delay) for _, script, delay in self._axes]

    def read(self, time_s: float) -> HandState:
        """Move the hand on to `time_s` and return its state."""
        gap = time_s - self._time
        if gap > 0.0:
            steps = min(max(round(gap / _SUBSTEP), 1), _SUBSTEPS_MAX)
            h = gap / steps
            for number in range(1, steps + 1):
                self._advance(self._time + number * h, h)
            self._time = time_s
        position, velocity = zip(*self._hands, strict=True)
        return HandState(position, velocity, self._config.is_pressed(time_s))

    def _advance(self, time_s: float, h: float) -> None:
        if time_s - self._written > _WATCHDOG:
            self._force = (0.0,) * self.axes
        self.applied = self._force
        self._hands = [
            advance_hand(axis, x, v, time_s - delay, force, h)
            for (x, v), force, (axis, _, delay) in zip(
                self._hands, self._force, self._axes, strict=True
            )
        ]

    def write(self, force: Axes) -> None:
        """Hold `force` from now on, until the next write or the watchdog."""
        require_force(force, self.axes)
        self._force = tuple(force)
        self._written = self._time

    def close(self) -> None:
        """Let go of the force."""
        self._force = self.applied = (0.0,) * self.axes
