"""A rig of your own: one motor that pulls a spring, with no sheath between them.

slave: {rig: {type: mylab, stiffness: 1500}}
"""

from dataclasses import dataclass

import numpy as np

from slave.rig import RigSample
from slave.rigs.extension import RigExtension


@dataclass(frozen=True)
class SpringRigConfig(RigExtension):
    """Keys of `slave.rig` in the config."""

    stiffness: float = 2000.0  # [N/m]

    def __post_init__(self) -> None:
        if self.stiffness <= 0.0:
            raise ValueError("stiffness: must be above 0 [N/m]")

    def open(self) -> "SpringRig":
        return SpringRig(self)


class SpringRig:
    """Gives one sample a read; real hardware hands over what its I/O thread received."""

    name, tendons, joints, starts_at_zero = "spring", 1, ((0,),), True

    def __init__(self, config: SpringRigConfig) -> None:
        self._stiffness, self._motor = config.stiffness, np.zeros(1)

    def read(self, time_s: float) -> tuple[RigSample, ...]:
        tension = np.maximum(self._stiffness * self._motor, 0.0)
        return (RigSample(time_s, tension, self._motor.copy()),)

    def write(self, proximal_displacement: np.ndarray) -> None:
        self._motor = proximal_displacement.copy()

    def advance(self) -> None: ...

    def summarise(self) -> dict[str, float]:
        return {"stiffness_N_per_m": self._stiffness}

    def close(self) -> None: ...
