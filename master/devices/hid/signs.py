"""The file of force signs: which way each device pushes, as found by trying it.

Conventions differ between firmwares, and whoever builds a device decides how its motor is wired. A
force of the wrong sign pushes the hand on instead of back, so an axis that is not in this file
renders none. Nor does one that is driven another way, or describes itself in another way, than when
it was tried: both may come with another convention. `teleop devices test` writes the file.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import yaml

from teleop import config
from teleop.errors import UsageError
from teleop.process import write_whole


class Pusher(NamedTuple):
    """What pushes: signs that were found for another say nothing of it."""

    device: str  # vendor:product, or vendor:product:serial
    driver: str
    layout: str  # fingerprint of its report descriptor


@dataclass(frozen=True, slots=True)
class ForceSign:
    """What was found for one axis of one pusher."""

    device: str  # these three as in `Pusher`
    driver: str
    layout: str
    axis: str  # its name, as in `master.device.axes`
    sign: Literal[1, -1]  # 1: a positive force pushes towards larger values of the axis

    @property
    def pusher(self) -> Pusher:
        """Whose it is."""
        return Pusher(self.device, self.driver, self.layout)


@dataclass(frozen=True, slots=True)
class Signs:
    """All that was found."""

    signs: tuple[ForceSign, ...] = ()

    def of(self, pusher: Pusher) -> dict[str, int]:
        """Return 1 or -1 for each axis whose sign was found."""
        return {s.axis: s.sign for s in self.signs if s.pusher == pusher}

    def having(self, found: ForceSign) -> "Signs":
        """Return these with one more, in place of what was found for the same axis before."""
        mine = found.pusher, found.axis
        return Signs((*(s for s in self.signs if (s.pusher, s.axis) != mine), found))


def default_path() -> Path:
    """Return where the file is kept if a config does not say."""
    home = os.environ.get("XDG_CONFIG_HOME") or "~/.config"
    return Path(home).expanduser() / "tendon-teleop" / "force-signs.yaml"


def load(path: Path | None) -> Signs:
    """Read the file; an absent one at the default place knows no signs.

    Raises
    ------
    UsageError
        It says what is not allowed, or a file that was named is not there.
    """
    if path is None and not default_path().exists():
        return Signs()
    if path is not None and not path.exists():
        raise UsageError(
            f"{path}: there are no force signs; find them with `teleop devices test --signs {path}`"
        )
    return config.load(path or default_path(), Signs, None)


def save(path: Path | None, signs: Signs) -> None:
    """Write the file, whole or not at all."""
    place = path or default_path()
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"{place.parent}: cannot be made: {error.strerror}") from error
    write_whole(place, yaml.safe_dump(config.as_tree(signs), sort_keys=False), "the force signs")
