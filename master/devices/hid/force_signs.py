"""Direction of each device's force: the file that keeps it, and the test that finds it.

Conventions and motor wiring differ between firmware and devices. A force of the wrong sign is
unstable, so an axis that is not in this file renders none; nor does one whose driver or report
descriptor has changed since the test, as either may change the convention. `teleop devices test`
writes the file.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, Protocol

from master.devices.hid.driver import Controls, Share
from teleop.config import loading, strict_yaml
from teleop.errors import UsageError
from teleop.runtime.files import find_config_folder
from teleop.runtime.process import write_text_file


class ForceSignKey(NamedTuple):
    """Identity of a device and driver; signs are valid for this combination only."""

    device: str  # vendor:product, or vendor:product:serial
    driver: str
    layout: str  # fingerprint of its report descriptor


@dataclass(frozen=True, slots=True)
class ForceSign:
    """Force sign of one axis of one device and driver."""

    device: str  # these three as in `ForceSignKey`
    driver: str
    layout: str
    axis: str  # its name, as in `master.device.axes`
    sign: Literal[1, -1]  # 1: a positive force pushes towards larger values of the axis

    @property
    def pusher(self) -> ForceSignKey:
        """The device and driver it belongs to."""
        return ForceSignKey(self.device, self.driver, self.layout)


@dataclass(frozen=True, slots=True)
class ForceSigns:
    """All force signs."""

    signs: tuple[ForceSign, ...] = ()

    def find_signs(self, pusher: ForceSignKey) -> dict[str, int]:
        """Return 1 or -1 for each axis with a known sign."""
        return {s.axis: s.sign for s in self.signs if s.pusher == pusher}

    def replace_sign(self, new_sign: ForceSign) -> "ForceSigns":
        """Return the signs with one added or replaced."""
        mine = new_sign.pusher, new_sign.axis
        return ForceSigns((*(s for s in self.signs if (s.pusher, s.axis) != mine), new_sign))


def get_default_path() -> Path:
    """Return the default path of the file."""
    return find_config_folder() / "tendon-teleop" / "force-signs.yaml"


def load(path: Path | None) -> ForceSigns:
    """Read the file; a missing file at the default path has no signs.

    `UsageError` if the content is invalid, or a given file does not exist.
    """
    if path is None and not get_default_path().exists():
        return ForceSigns()
    if path is not None and not path.exists():
        raise UsageError(
            f"{path}: no such file of force signs; make it with `teleop devices test --signs "
            f"{path}`"
        )
    return loading.load(path or get_default_path(), ForceSigns, None)


def save(path: Path | None, signs: ForceSigns) -> None:
    """Write the file atomically."""
    target = path or get_default_path()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{target.parent}: cannot be created: {error.strerror}") from error
    write_text_file(target, strict_yaml.format_document(loading.as_tree(signs)), "the force signs")


# --- find the force sign of an axis: push it gently once each way and observe its motion
# The force is increased in steps until the axis moves, then removed at once. If a hand or a spring
# moves it the same way both times, the result is undecided.


TEST_FORCES = (0.05, 0.1, 0.2)  # shares of full force, tried in turn
PUSH_S = 0.4  # [s] of one push, at most
REST_S = 0.4  # [s] before it, for the device to come to rest
MOTION_MIN = 0.02  # of full scale of the axis: counts as moved
STEP_S = 0.002  # [s] between two looks
HOLD_S = 2.0  # [s] of a push that a person has to judge


class PushableDevice(Protocol):
    """A device with a force (`master.devices.hid.connection.DeviceConnection`)."""

    def read(self, time_s: float) -> Controls:
        """Return the inputs."""

    def post(self, force: tuple[Share, ...]) -> None:
        """Set the force until the next call."""


Clock = Callable[[], float]
Sleep = Callable[[float], None]


def infer_sign(forth: Share, back: Share) -> int:
    """Return the sign from the motions of a push and the opposite push; 0 = undecided.

    1 means that a positive force pushes towards larger values of the axis.
    """
    if min(abs(forth), abs(back)) < MOTION_MIN or (forth > 0.0) == (back > 0.0):
        return 0
    return 1 if forth > 0.0 else -1


def find_sign(
    device: PushableDevice, axis: int, force: int, forces: int, clock: Clock, sleep: Sleep
) -> int:
    """Push one force axis both ways, increasing until it moves; return its sign, 0 = not found.

    `axis` and `force` are its index in the driver's axes and in its `forces`.
    """
    for share in TEST_FORCES:
        sign = infer_sign(
            push_axis(device, axis, force, forces, share, clock, sleep),
            push_axis(device, axis, force, forces, -share, clock, sleep),
        )
        if sign:
            return sign
    return 0


def push_axis(
    device: PushableDevice,
    axis: int,
    force: int,
    forces: int,
    share: Share,
    clock: Clock,
    sleep: Sleep,
) -> Share:
    """Push one way until the axis moves; return how far. The force is zero afterwards."""
    no_force = (0.0,) * forces
    pushed = tuple(share if k == force else 0.0 for k in range(forces))
    _wait_at_rest(device, no_force, clock, sleep)
    start = device.read(clock()).axes[axis]
    distance, end = 0.0, clock() + PUSH_S
    try:
        while clock() < end and not abs(distance) > 2.0 * MOTION_MIN:
            device.post(pushed)
            sleep(STEP_S)
            distance = device.read(clock()).axes[axis] - start
    finally:
        device.post(no_force)
    return 0.0 if math.isnan(distance) else distance


def _wait_at_rest(
    device: PushableDevice, no_force: tuple[Share, ...], clock: Clock, sleep: Sleep
) -> None:
    end = clock() + REST_S
    while clock() < end:
        device.post(no_force)
        device.read(clock())
        sleep(STEP_S)


def hold_force(
    device: PushableDevice, force: int, forces: int, share: Share, clock: Clock, sleep: Sleep
) -> None:
    """Push one way for `HOLD_S`, for a person to feel it. The force is zero afterwards."""
    pushed = tuple(share if k == force else 0.0 for k in range(forces))
    end = clock() + HOLD_S
    try:
        while clock() < end:
            device.post(pushed)
            device.read(clock())
            sleep(STEP_S)
    finally:
        device.post((0.0,) * forces)
