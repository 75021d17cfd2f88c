"""Config of a HID device: selection, axes and buttons."""

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal

from master.devices.hid.pid import PidConfig
from teleop.messages.messages import MAX_JOINTS


@dataclass(frozen=True, slots=True)
class AxisConfig:
    """Mapping of one axis of the device to a joint, and its force."""

    name: str = "x"  # of the input: x, y, rz, l2, ...; `teleop devices probe` lists them
    joint: int | None = None  # moved by it, counted from 0; null = its place in the list
    travel: float = 0.0  # [m] of the hand from the middle (or rest) to the end
    speed: float = 0.0  # [m/s] of the hand at the end; instead of `travel`, for rate control
    sign: Literal[1, -1] = 1  # -1 reverses the joint's direction, for motion and force
    dead_zone: float = 0.0  # fraction of the way to the end that counts as the middle
    force: float = 0.0  # [N] of the device at full scale; 0 = no force

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        if not self.name:
            raise ValueError("name: must name an input of the device")
        if self.joint is not None and not 0 <= self.joint < MAX_JOINTS:
            raise ValueError(f"joint: must be within 0 ... {MAX_JOINTS - 1}")
        if not 0.0 <= self.travel <= 1.0:
            raise ValueError("travel: must be within 0 ... 1 [m]")
        if not 0.0 <= self.speed <= 1.0:
            raise ValueError("speed: must be within 0 ... 1 [m/s]")
        if (self.travel > 0.0) == (self.speed > 0.0):
            raise ValueError(f"travel, speed: exactly one must be above 0 (axis {self.name!r})")
        if not 0.0 <= self.dead_zone <= 0.9:
            raise ValueError("dead_zone: must be within 0 ... 0.9 of the way to the end")
        if not 0.0 <= self.force <= 100.0:
            raise ValueError("force: must be within 0 ... 100 [N]")


@dataclass(frozen=True, slots=True)
class ButtonsConfig:
    """Button numbers of the functions, counted from 1."""

    engage: int = 1  # engage switch
    clutch: int | None = None  # clutch: move the hand without the tips
    stop: int | None = None  # emergency stop
    finer: int | None = None  # decreases the position scale by a step
    coarser: int | None = None  # ... larger
    weaker: int | None = None  # decreases the force scale by a step
    stronger: int | None = None  # ... larger
    find: str = ""  # device with the buttons, as in `find` below; empty = the same one

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        assigned = self.assigned
        for name, number in assigned.items():
            if not 1 <= number <= 128:
                raise ValueError(f"{name}: must be within 1 ... 128")
        if len(set(assigned.values())) != len(assigned):
            raise ValueError(f"{', '.join(assigned)}: must be different buttons")

    @property
    def assigned(self) -> dict[str, int]:
        """Numbers of the assigned buttons, by their field of `HandState`."""
        numbers = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "find"}
        return {name: number for name, number in numbers.items() if number is not None}


@dataclass(frozen=True, slots=True)
class HidConfig:
    """A HID haptic device."""

    type: Literal["hid"] = "hid"
    find: str = ""  # vendor:product, serial number or path; empty = the only one that fits
    driver: Literal["auto", "pid", "ffbeast", "dualsense", "spacemouse", "logitech", "joystick"] = (
        "auto"
    )
    axes: tuple[AxisConfig, ...] = (AxisConfig(travel=0.05),)
    buttons: ButtonsConfig = ButtonsConfig()
    pid: PidConfig = field(
        default_factory=PidConfig
    )  # effects rendered by a device of the PID class itself
    smoothing: float = 0.010  # [s] time constant of the velocity's filter
    signs: Path | None = None  # file of force signs; null = ~/.config/tendon-teleop/

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        if not 1 <= len(self.axes) <= MAX_JOINTS:
            raise ValueError(f"axes: 1 to {MAX_JOINTS} are needed")
        if len(set(self.joints)) != len(self.axes):
            raise ValueError("axes: each must move a different joint")
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
        """Number of joints, including those left out between others."""
        return max(self.joints) + 1
