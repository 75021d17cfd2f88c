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

    def of(self, pusher: ForceSignKey) -> dict[str, int]:
        """Return 1 or -1 for each axis with a known sign."""
        return {s.axis: s.sign for s in self.signs if s.pusher == pusher}

    def having(self, found: ForceSign) -> "ForceSigns":
        """Return the signs with one added or replaced."""
        mine = found.pusher, found.axis
        return ForceSigns((*(s for s in self.signs if (s.pusher, s.axis) != mine), found))


def get_default_path() -> Path:
    """Return the default path of the file."""
    return find_config_folder() / "tendon-teleop" / "force-signs.yaml"


def load(path: Path | None) -> ForceSigns:
    """Read the file; a missing file at the default path has no signs.

    Raises
    ------
    UsageError
        The content is invalid, or a given file does not exist.
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
    place = path or get_default_path()
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{place.parent}: cannot be created: {error.strerror}") from error
    write_text_file(
        place, yaml.safe_dump(loading.as_tree(signs), sort_keys=False), "the force signs"
    )
