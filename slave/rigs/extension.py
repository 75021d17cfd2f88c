"""Base class of the configs of rigs in other packages."""

from dataclasses import dataclass
from typing import ClassVar

from slave.rig import Rig
from teleop.extensions import Extension


@dataclass(frozen=True)
class RigExtension(Extension):
    """Base of the configs of rigs of other packages (docs/rigs.md, "A rig of your own")."""

    GROUP: ClassVar[str] = "teleop.rigs"

    def open(self) -> Rig:
        """Open the rig that this config describes; raises `slave.rig.RigFault` on failure."""
        raise NotImplementedError
