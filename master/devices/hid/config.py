"""The config of a HID device: which one, and what its inputs do."""

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal

from master.devices.hid.pid import PidConfig
from teleop.messages import MAX_JOINTS


@dataclass(frozen=True, slots=True)
class AxisConfig:
    """What one input of the device moves, and how hard the device may push on it."""

    name: str = "x"  # of the input: x, y, rz, l2, ...; `teleop devices probe` lists them
    joint: int | None = None  # that it moves, counted from 0; null = its place in the list
    travel: float = 0.0  # [m] the hand has moved between the middle (or rest) and the end
    speed: float = 0.0  # [m/s] of the hand at the end; in place of `travel`, for rate control
    sign: Literal[1, -1] = 1  # -1 turns the joint's direction round, motion and force alike
    dead_zone: float = 0.0  # share of the way to the end that counts as the middle
    force: float = 0.0  # [N] with which the device pushes at its full scale; 0 = it never pushes

    def __post_init__(self) -> None:
        """Refuse an axis that moves nothing, or two things."""
        if not self.name:
            raise ValueError("name: must name an input of the device")
        if self.joint is not None and not 0 <= self.joint < MAX_JOINTS:
            raise ValueError(f"joint: must be within 0 ... {MAX_JOINTS - 1}")
        if not 0.0 <= self.travel <= 1.0:
            raise ValueError("travel: must be within 0 ... 1 [m]")
        if not 0.0 <= self.speed <= 1.0:
            raise ValueError("speed: must be within 0 ... 1 [m/s]")
        if (self.travel > 0.0) == (self.speed > 0.0):
            raise ValueError(f"travel and speed: one of them must be above 0 (axis {self.name!r})")
        if not 0.0 <= self.dead_zone <= 0.9:
            raise ValueError("dead_zone: must be within 0 ... 0.9 of the way to the end")
        if not 0.0 <= self.force <= 100.0:
            raise ValueError("force: must be within 0 ... 100 [N]")


@dataclass(frozen=True, slots=True)
class ButtonsConfig:
    """Which buttons do what, counted from 1."""

    engage: int = 1  # held to be engaged
    clutch: int | None = None  # held to move the hand without moving anything else
    stop: int | None = None  # emergency stop
    finer: int | None = None  # makes the position scale smaller by a step
    coarser: int | None = None  # ... larger
    weaker: int | None = None  # makes the force scale smaller by a step
    stronger: int | None = None  # ... larger
    find: str = ""  # the device that has them, as in `find` above; empty = the same one

    def __post_init__(self) -> None:
        """Refuse a button with two meanings."""
        assigned = self.assigned
        for name, number in assigned.items():
            if not 1 <= number <= 128:
                raise ValueError(f"{name}: must be within 1 ... 128")
        if len(set(assigned.values())) != len(assigned):
            raise ValueError(f"{', '.join(assigned)}: must be different buttons")

    @property
    def assigned(self) -> dict[str, int]:
        """The buttons that there are: `HandState`'s name of each, and its number."""
        numbers = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "find"}
        return {name: number for name, number in numbers.items() if number is not None}


@dataclass(frozen=True, slots=True)
class HidConfig:
    """A haptic device that speaks HID."""

    type: Literal["hid"] = "hid"
    find: str = ""  # vendor:product, serial number or path; empty = the only one that fits
    driver: Literal["auto", "pid", "ffbeast", "dualsense", "spacemouse", "logitech", "joystick"] = (
        "auto"
    )
    axes: tuple[AxisConfig, ...] = (AxisConfig(travel=0.05),)
    buttons: ButtonsConfig = ButtonsConfig()
    pid: PidConfig = field(
        default_factory=PidConfig
    )  # what a device of that class renders by itself
    smoothing: float = 0.010  # [s] time constant of the velocity's filter
    signs: Path | None = None  # file of force signs; null = ~/.config/tendon-teleop/

    def __post_init__(self) -> None:
        """Refuse a joint that two axes move."""
        if not 1 <= len(self.axes) <= MAX_JOINTS:
            raise ValueError(f"axes: 1 to {MAX_JOINTS} are needed")
        if len(set(self.joints)) != len(self.axes):
            raise ValueError("axes: each must move a joint of its own")
        if len({axis.name for axis in self.axes}) != len(self.axes):
            raise ValueError("axes: each must be a different input of the device")
        if not 0.0 <= self.smoothing <= 0.1:
            raise ValueError("smoothing: must be within 0 ... 0.1 [s]")

    @property
    def joints(self) -> tuple[int, ...]:
        """The joint that each axis moves."""
        return tuple(k if a.joint is None else a.joint for k, a in enumerate(self.axes))

    @property
    def axis_count(self) -> int:
        """How many joints it moves; one that is left out between two others counts."""
        return max(self.joints) + 1
