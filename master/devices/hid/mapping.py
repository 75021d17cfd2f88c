"""Map a device's inputs to the hand, and forces on the hand to shares of full scale. Pure.

An axis with `travel` gives the position of the hand: x = travel * share. One with `speed` gives its
velocity while the engage button is held: x' = speed * share. The velocity of the former is that of
its position through a first-order filter, smoothing * v' = x' - v, in backward-Euler steps.

Inputs not reported yet are unknown. An unknown input moves nothing, and until every assigned button
and every axis with `travel` is known, the engage button counts as held: a session that starts, or
is at fault, requires an open switch first. In any other session that would be a false press, so it
must be a fault if a known input becomes unknown: see `MappingState.knows`.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

from master.device import Axes, DeviceFault, HandState
from master.devices.hid.config import AxisConfig, HidConfig
from master.devices.hid.driver import Controls, HidDriver, Share


class AxisMapping(NamedTuple):
    """Mapping between one input of the device and one joint."""

    joint: int
    axis: int  # its place in `Driver.axes`
    rate: bool  # whether the input is a velocity
    scale: float  # [m] or [m/s] of the joint at full scale, signed
    dead_zone: float
    force: int  # its place in `Driver.forces`, -1 = none
    per_newton: float  # share of full scale for 1 N on the joint, signed; 0 = unknown sign


class DeviceMapping(NamedTuple):
    """Constants of an open device."""

    joints: int
    lanes: tuple[AxisMapping, ...]
    forces: int
    buttons: tuple[tuple[str, int], ...]  # name in `HandState`, and mask
    smoothing: float  # [s]


class MappingState(NamedTuple):
    """State between reads, one number per joint."""

    position: Axes  # [m]
    velocity: Axes  # [m/s]
    known: tuple[bool, ...]  # whether the position was reported
    knows: bool = False  # whether all needed inputs are known


def build_mapping(
    config: HidConfig, driver: HidDriver, buttons: int, signs: Mapping[str, int]
) -> DeviceMapping:
    """Return the mapping from a device to the hand.

    Parameters
    ----------
    buttons : int
        Number of buttons of the device with the buttons.
    signs : mapping of str to int
        Force sign of each axis, if known.

    Raises
    ------
    DeviceFault
        The device lacks an input of the config; the message names the key.
    """
    for name, number in config.buttons.assigned.items():
        if number > buttons:
            raise DeviceFault(
                f"buttons.{name}: there is no button {number}; the device has {buttons or 'none'}"
                + "; set buttons.find to another device for them" * (not buttons)
            )
    lanes = tuple(
        _build_axis_mapping(axis, joint, driver, signs)
        for axis, joint in zip(config.axes, config.joints, strict=True)
    )
    return DeviceMapping(
        joints=max(config.joints) + 1,
        lanes=lanes,
        forces=len(driver.forces),
        buttons=tuple((name, 1 << (n - 1)) for name, n in config.buttons.assigned.items()),
        smoothing=config.smoothing,
    )


def _build_axis_mapping(
    axis: AxisConfig, joint: int, driver: HidDriver, signs: Mapping[str, int]
) -> AxisMapping:
    if axis.name not in driver.axes:
        known = ", ".join(driver.axes)
        raise DeviceFault(f"axes: the device has no axis {axis.name!r}; it has {known}")
    place, per_newton = -1, 0.0
    if axis.force > 0.0:
        if axis.name not in driver.forces:
            known = ", ".join(driver.forces) or "no axis"
            raise DeviceFault(f"axes: force: the device cannot push {axis.name!r}, but {known}")
        place = driver.forces.index(axis.name)
        per_newton = axis.sign * signs.get(axis.name, 0) / axis.force
    return AxisMapping(
        joint=joint,
        axis=driver.axes.index(axis.name),
        rate=axis.speed > 0.0,
        scale=axis.sign * (axis.speed or axis.travel),
        dead_zone=axis.dead_zone,
        force=place,
        per_newton=per_newton,
    )


def _has_all_inputs(plan: DeviceMapping, controls: Controls, switches: Controls) -> bool:
    return all(mask & switches.known for _, mask in plan.buttons) and not any(
        math.isnan(controls.axes[lane.axis]) for lane in plan.lanes if not lane.rate
    )


def init_mapping(joints: int) -> MappingState:
    """Return the initial state."""
    return MappingState((0.0,) * joints, (0.0,) * joints, (False,) * joints)


def step(
    plan: DeviceMapping, memory: MappingState, controls: Controls, switches: Controls, dt: float
) -> tuple[HandState, MappingState]:
    """Return the hand after `dt` [s]; `switches` are the controls that have the buttons."""
    held = {name: bool(mask & switches.buttons) for name, mask in plan.buttons}
    knows = _has_all_inputs(plan, controls, switches)
    driven = held["engage"] and not held.get("clutch", False)
    position, velocity = list(memory.position), [0.0] * plan.joints
    known = [False] * plan.joints
    for lane in plan.lanes:
        share, joint = controls.axes[lane.axis], lane.joint
        if lane.rate:
            if driven and not math.isnan(share):
                velocity[joint] = lane.scale * apply_dead_zone(share, lane.dead_zone)
                position[joint] += velocity[joint] * dt
        elif not math.isnan(share):
            position[joint] = lane.scale * apply_dead_zone(share, lane.dead_zone)
            known[joint] = True
            if memory.known[joint]:
                way = position[joint] - memory.position[joint]
                was = memory.velocity[joint]
                blend = plan.smoothing + dt
                velocity[joint] = (plan.smoothing * was + way) / blend if blend > 0.0 else was
    hand = HandState(
        position=tuple(position),
        velocity=tuple(velocity),
        **{**held, "engage": held["engage"] or not knows},
    )
    return hand, MappingState(hand.position, hand.velocity, tuple(known), knows)


def apply_dead_zone(share: Share, dead_zone: float) -> Share:
    """Return `share` with a continuous dead zone, rescaled to full scale."""
    way = (abs(share) - dead_zone) / (1.0 - dead_zone)
    return math.copysign(way, share) if way > 0.0 else 0.0


def to_force_shares(plan: DeviceMapping, force: Axes) -> tuple[Share, ...]:
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
