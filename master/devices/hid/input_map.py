"""Config of a HID device, and the map of its inputs to the hand and of forces to its axes.

Pure. An axis with `travel` gives the position of the hand: x = travel * share. One with `speed`
gives its velocity while the engage button is held: x' = speed * share. The velocity of the former
is that of its position through a first-order filter, smoothing * v' = x' - v, in backward-Euler
steps. Its middle is where it rests with an open switch, near that of the device.

Inputs not reported yet are unknown. An unknown input moves nothing, and until every assigned button
and every axis with `travel` is known, the engage button counts as held: a session that starts, or
is at fault, requires an open switch first. In any other session that would be a false press, so it
must be a fault if a known input becomes unknown: see `InputMapState.knows`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal, NamedTuple

from master.device import Axes, DeviceFault, HandState
from master.devices.hid.driver import Controls, HidDriver, Share
from master.devices.hid.pid import PidConfig
from teleop.config.ranges import build_ranged_field, check_ranges
from teleop.messages.messages import MAX_JOINTS

# --- config of a HID device: selection, axes and buttons


@dataclass(frozen=True, slots=True)
class AxisConfig:
    """Mapping of one axis of the device to a joint, and its force."""

    name: str = "x"  # of the input: x, y, rz, l2, ...; `teleop devices probe` lists them
    # moved by it, counted from 0; null = its place in the list
    joint: int | None = build_ranged_field(None, 0, MAX_JOINTS - 1)
    # of the hand from the middle (or rest) to the end
    travel: float = build_ranged_field(0.0, 0.0, 1.0, "m")
    # of the hand at the end; instead of `travel`, for rate control
    speed: float = build_ranged_field(0.0, 0.0, 1.0, "m/s")
    sign: Literal[1, -1] = 1  # -1 reverses the joint's direction, for motion and force
    # fraction of the way to the end that counts as the middle
    dead_zone: float = build_ranged_field(0.0, 0.0, 0.9)
    # of the device at full scale; 0 = no force
    force: float = build_ranged_field(0.0, 0.0, 100.0, "N")

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.name:
            raise ValueError("name: must name an input of the device")
        if (self.travel > 0.0) == (self.speed > 0.0):
            raise ValueError(f"travel, speed: exactly one must be above 0 (axis {self.name!r})")


@dataclass(frozen=True, slots=True)
class ButtonsConfig:
    """Button numbers of the functions, counted from 1."""

    engage: int = build_ranged_field(1, 1, 128)  # engage switch
    clutch: int | None = build_ranged_field(None, 1, 128)  # clutch: move the hand without the tips
    stop: int | None = build_ranged_field(None, 1, 128)  # emergency stop
    finer: int | None = build_ranged_field(None, 1, 128)  # decreases the position scale by a step
    coarser: int | None = build_ranged_field(None, 1, 128)  # increases the position scale by a step
    weaker: int | None = build_ranged_field(None, 1, 128)  # decreases the force scale by a step
    stronger: int | None = build_ranged_field(None, 1, 128)  # increases the force scale by a step
    find: str = ""  # device with the buttons, as in `find` below; empty = the same one

    def __post_init__(self) -> None:
        check_ranges(self)
        assigned = self.assigned
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
    # protocol of the device; auto = by what it is
    driver: Literal["auto", "pid", "ffbeast", "dualsense", "spacemouse", "logitech", "joystick"] = (
        "auto"
    )
    axes: tuple[AxisConfig, ...] = (AxisConfig(travel=0.05),)
    buttons: ButtonsConfig = ButtonsConfig()
    # effects rendered by a device of the PID class itself
    pid: PidConfig = field(default_factory=PidConfig)
    # time constant of the velocity's filter
    smoothing: float = build_ranged_field(0.010, 0.0, 0.1, "s")
    signs: Path | None = None  # file of force signs; null = ~/.config/tendon-teleop/

    def __post_init__(self) -> None:
        check_ranges(self)
        if not 1 <= len(self.axes) <= MAX_JOINTS:
            raise ValueError(f"axes: 1 to {MAX_JOINTS} are needed")
        if len(set(self.joints)) != len(self.axes):
            raise ValueError("axes: each must move a different joint")
        if len({axis.name for axis in self.axes}) != len(self.axes):
            raise ValueError("axes: each must be a different input of the device")

    @property
    def joints(self) -> tuple[int, ...]:
        """The joint that each axis moves."""
        return tuple(k if a.joint is None else a.joint for k, a in enumerate(self.axes))

    @property
    def axis_count(self) -> int:
        """Number of joints, including those left out between others."""
        return max(self.joints) + 1


class InputLane(NamedTuple):
    """Map between one input of the device and one joint."""

    joint: int
    axis: int  # its place in `HidDriver.axes`
    rate: bool  # whether the input is a velocity
    scale: float  # [m] or [m/s] of the joint at full scale, signed
    dead_zone: float
    force: int  # its place in `HidDriver.forces`, -1 = none
    per_newton: float  # share of full scale for 1 N on the joint, signed; 0 = unknown sign


class InputMap(NamedTuple):
    """Constants of an open device."""

    joints: int
    lanes: tuple[InputLane, ...]
    forces: int
    buttons: tuple[tuple[str, int], ...]  # name in `HandState`, and mask
    assigned: int  # mask of all of these
    smoothing: float  # [s]


REST_S = 1.0  # [s] that an axis stays within its band until it counts as at rest
REST_BAND, REST_MAX = 0.01, 0.15  # shares: of the band, and of the middle that is learnt at most


class RestPosition(NamedTuple):
    """Where an axis of rate control rests: the middle of a device may drift with use."""

    centre: Share = 0.0  # which reads as 0
    share: Share = 0.0  # around which it stays
    time_s: float = 0.0  # [s] for which it does

    def step(self, share: Share, dt: float) -> "RestPosition":
        """Return the state after `dt` [s] at `share` with an open switch."""
        if not abs(share - self.share) <= REST_BAND:
            return self._replace(share=share, time_s=0.0)
        time_s = min(self.time_s + dt, REST_S)
        is_rest = time_s >= REST_S and abs(share) <= REST_MAX
        return RestPosition(self.share if is_rest else self.centre, self.share, time_s)


class InputMapState(NamedTuple):
    """State between reads, one number per joint."""

    position: Axes  # [m]
    velocity: Axes  # [m/s]
    known: tuple[bool, ...]  # whether the position was reported
    knows: bool = False  # whether all needed inputs are known
    rests: tuple[RestPosition, ...] = (RestPosition(),) * MAX_JOINTS  # of each lane


def build_input_map(
    config: HidConfig, driver: HidDriver, buttons: int, signs: Mapping[str, int]
) -> InputMap:
    """Return the map from a device to the hand.

    `buttons` is the number of buttons of the device with the buttons, `signs` the force sign of
    each axis, if known. `DeviceFault` if the device lacks an input of the config; the message names
    the key.
    """
    for name, number in config.buttons.assigned.items():
        if number > buttons:
            raise DeviceFault(
                f"buttons.{name}: there is no button {number}; the device has {buttons or 'none'}"
                + "; set buttons.find to another device for them" * (not buttons)
            )
    lanes = tuple(
        _build_lane(axis, joint, driver, signs)
        for axis, joint in zip(config.axes, config.joints, strict=True)
    )
    return InputMap(
        joints=max(config.joints) + 1,
        lanes=lanes,
        forces=len(driver.forces),
        buttons=tuple((name, 1 << (n - 1)) for name, n in config.buttons.assigned.items()),
        assigned=sum(1 << (n - 1) for n in config.buttons.assigned.values()),
        smoothing=config.smoothing,
    )


def _build_lane(
    axis: AxisConfig, joint: int, driver: HidDriver, signs: Mapping[str, int]
) -> InputLane:
    if axis.name not in driver.axes:
        axis_names = ", ".join(driver.axes)
        raise DeviceFault(f"axes: the device has no axis {axis.name!r}; it has {axis_names}")
    place, per_newton = -1, 0.0
    if axis.force > 0.0:
        if axis.name not in driver.forces:
            axis_names = ", ".join(driver.forces)
            raise DeviceFault(
                f"axes: force: the device cannot push {axis.name!r}, but {axis_names}"
                if axis_names
                else f"axes: force: the device has no force: set it to 0 for {axis.name!r}, or set "
                "find to another device (`teleop devices list`)"
            )
        place = driver.forces.index(axis.name)
        per_newton = axis.sign * signs.get(axis.name, 0) / axis.force
    return InputLane(
        joint=joint,
        axis=driver.axes.index(axis.name),
        rate=axis.speed > 0.0,
        scale=axis.sign * (axis.speed or axis.travel),
        dead_zone=axis.dead_zone,
        force=place,
        per_newton=per_newton,
    )


def _has_all_inputs(plan: InputMap, controls: Controls, switches: Controls) -> bool:
    return all(mask & switches.known for _, mask in plan.buttons) and not any(
        math.isnan(controls.axes[lane.axis]) for lane in plan.lanes if not lane.rate
    )


def init_input_map(joints: int) -> InputMapState:
    """Return the initial state."""
    return InputMapState((0.0,) * joints, (0.0,) * joints, (False,) * joints)


def step(
    plan: InputMap, memory: InputMapState, controls: Controls, switches: Controls, dt: float
) -> tuple[HandState, InputMapState]:
    """Return the hand after `dt` [s]; `switches` are the controls that have the buttons."""
    pressed = {name: bool(mask & switches.buttons) for name, mask in plan.buttons}
    has_inputs = _has_all_inputs(plan, controls, switches)
    driven = pressed["engage"] and not pressed.get("clutch", False)
    position, velocity = list(memory.position), [0.0] * plan.joints
    is_reported, rests = [False] * plan.joints, list(memory.rests)
    for k, lane in enumerate(plan.lanes):
        share, joint = controls.axes[lane.axis], lane.joint
        if lane.rate:
            if not pressed["engage"]:  # while it moves the tip its middle stays
                rests[k] = rests[k].step(share, dt)
            if driven and not math.isnan(share):
                offset = min(max(share - rests[k].centre, -1.0), 1.0)
                velocity[joint] = lane.scale * apply_dead_zone(offset, lane.dead_zone)
                position[joint] += velocity[joint] * dt
        elif not math.isnan(share):
            position[joint] = lane.scale * apply_dead_zone(share, lane.dead_zone)
            is_reported[joint] = True
            if memory.known[joint]:
                change = position[joint] - memory.position[joint]
                was = memory.velocity[joint]
                blend = plan.smoothing + dt
                velocity[joint] = (plan.smoothing * was + change) / blend if blend > 0.0 else was
    hand = HandState(
        position=tuple(position),
        velocity=tuple(velocity),
        **{**pressed, "engage": pressed["engage"] or not has_inputs},
        buttons=list_buttons(switches.buttons & ~plan.assigned),
    )
    return hand, InputMapState(
        hand.position, hand.velocity, tuple(is_reported), has_inputs, tuple(rests)
    )


def list_buttons(mask: int) -> tuple[int, ...]:
    """Return the numbers, from 1, of the bits of a mask."""
    return tuple(n for n in range(1, mask.bit_length() + 1) if mask >> (n - 1) & 1) if mask else ()


def apply_dead_zone(share: Share, dead_zone: float) -> Share:
    """Return `share` with a continuous dead zone, rescaled to full scale."""
    remaining = (abs(share) - dead_zone) / (1.0 - dead_zone)
    return math.copysign(remaining, share) if remaining > 0.0 else 0.0


def to_force_shares(plan: InputMap, force: Axes) -> tuple[Share, ...]:
    """Return forces on the joints [N] as shares of the device's full scale.

    Clipped to full scale; NaN and axes of unknown sign are zero.
    """
    out = [0.0] * plan.forces
    for lane in plan.lanes:
        if lane.force >= 0:
            share = force[lane.joint] * lane.per_newton
            if not math.isnan(share):
                out[lane.force] = min(max(share, -1.0), 1.0)
    return tuple(out)


def find_unsigned_axes(config: HidConfig, signs: Mapping[str, int]) -> list[str]:
    """Return the axes without force because their sign is unknown."""
    return [a.name for a in config.axes if a.force > 0.0 and a.name not in signs]
