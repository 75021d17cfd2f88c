"""Base class of the configs of rigs in other packages."""

from dataclasses import dataclass
from typing import ClassVar

from slave.rig import Rig, RigFault
from teleop.config.extensions import Extension


@dataclass(frozen=True)
class RigExtension(Extension):
    """Base of the configs of rigs of other packages (docs/rigs.md, "A rig of your own")."""

    GROUP: ClassVar[str] = "teleop.rigs"

    def open(self) -> Rig:
        """Open the rig that this config describes; raises `slave.rig.RigFault` on failure."""
        raise NotImplementedError

    def open_read_only(self) -> Rig:
        """Open the rig so that nothing is written to its hardware, and no motor is enabled.

        For `teleop rig check --read-only`; a rig that supports it overrides this. Never written to.
        """
        raise RigFault(
            f"{self.type}: does not support --read-only; its config class would have open_read_only"
        )
