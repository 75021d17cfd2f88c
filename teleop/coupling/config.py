"""What both sides must agree on about the force that crosses the network."""

import zlib
from functools import lru_cache
from typing import NamedTuple

from teleop.confidence import ConfidenceConfig
from teleop.coupling.direct import DirectConfig
from teleop.coupling.passivity import PassivityConfig
from teleop.coupling.wave import WaveConfig

CouplingConfig = PassivityConfig | WaveConfig | DirectConfig

NOT_TOLD = 0


class Bilateral(NamedTuple):
    """The rule of confidence and the coupling."""

    confidence: ConfidenceConfig = ConfidenceConfig()
    coupling: CouplingConfig = DirectConfig()

    @property
    def signature(self) -> int:
        """A number for this choice, never `NOT_TOLD`; the messages of each side carry its own."""
        return _signature(self)

    def differs(self, told: int) -> bool:
        """Return whether the other side has `told` another choice than this."""
        return told not in (NOT_TOLD, self.signature)


@lru_cache(maxsize=8)
def _signature(bilateral: Bilateral) -> int:
    return zlib.crc32(repr(bilateral).encode()) or 1
