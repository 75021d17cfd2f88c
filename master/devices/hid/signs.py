"""The file of force signs: direction of each device's force, found by test.

Conventions and motor wiring differ between firmware and devices. A force of the wrong sign is
unstable, so an axis that is not in this file renders none; nor does one whose driver or report
descriptor has changed since the test, as either may change the convention. `teleop devices test`
writes the file.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import yaml

from teleop.config import loading
from teleop.errors import UsageError
from teleop.runtime.process import write_whole
from teleop.runtime.user_folders import config_folder


class Pusher(NamedTuple):
    """Identity of a device and driver; signs are valid for this combination only."""

    device: str  # vendor:product, or vendor:product:serial
    driver: str
    layout: str  # fingerprint of its report descriptor


@dataclass(frozen=True, slots=True)
class ForceSign:
    """Force sign of one axis of one device and driver."""

    device: str  # these three as in `Pusher`
    driver: str
    layout: str
    axis: str  # its name, as in `master.device.axes`
    sign: Literal[1, -1]  # 1: a positive force pushes towards larger values of the axis

    @property
    def pusher(self) -> Pusher:
        """The device and driver it belongs to."""
        return Pusher(self.device, self.driver, self.layout)


@dataclass(frozen=True, slots=True)
class Signs:
    """All force signs."""

    signs: tuple[ForceSign, ...] = ()

    def of(self, pusher: Pusher) -> dict[str, int]:
        """Return 1 or -1 for each axis with a known sign."""
        return {s.axis: s.sign for s in self.signs if s.pusher == pusher}

    def having(self, found: ForceSign) -> "Signs":
        """Return the signs with one added or replaced."""
        mine = found.pusher, found.axis
        return Signs((*(s for s in self.signs if (s.pusher, s.axis) != mine), found))


def default_path() -> Path:
    """Return the default path of the file."""
    return config_folder() / "tendon-teleop" / "force-signs.yaml"


def load(path: Path | None) -> Signs:
    """Read the file; a missing file at the default path has no signs.

    Raises
    ------
    UsageError
        The content is invalid, or a given file does not exist.
    """
    if path is None and not default_path().exists():
        return Signs()
    if path is not None and not path.exists():
        raise UsageError(
            f"{path}: no such file of force signs; make it with `teleop devices test --signs "
            f"{path}`"
        )
    return loading.load(path or default_path(), Signs, None)


def save(path: Path | None, signs: Signs) -> None:
    """Write the file atomically."""
    place = path or default_path()
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{place.parent}: cannot be created: {error.strerror}") from error
    write_whole(place, yaml.safe_dump(loading.as_tree(signs), sort_keys=False), "the force signs")
