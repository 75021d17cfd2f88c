"""Settings of the bilateral coupling that both sides must share."""

import zlib
from functools import lru_cache
from typing import Annotated, Any, NamedTuple

from estimator.compiled import compiled
from estimator.records import F64, I64, U32, Field, Record, Records, as_records, record_dtype
from teleop.coupling.direct import DirectConfig
from teleop.coupling.force_attenuation import ConfidenceConfig
from teleop.coupling.passivity import PassivityConfig
from teleop.coupling.wave import WaveConfig

CouplingConfig = PassivityConfig | WaveConfig | DirectConfig

NO_SIGNATURE = 0
DIRECT, PASSIVITY, WAVE = range(3)
KINDS: dict[type[Any], int] = {
    DirectConfig: DIRECT,
    PassivityConfig: PASSIVITY,
    WaveConfig: WAVE,
}


class Bilateral(NamedTuple):
    """The force attenuation and the coupling that both sides use."""

    confidence: ConfidenceConfig = ConfidenceConfig()
    coupling: CouplingConfig = DirectConfig()

    @property
    def signature(self) -> int:
        """Non-zero hash of these settings; each side sends its own."""
        return _signature(self)

    def differs(self, signature: int) -> bool:
        """Return whether the peer's `signature` belongs to other settings than these."""
        return signature not in (NO_SIGNATURE, self.signature)


class BilateralSettings(Record):
    """A `Bilateral` for compiled functions; only the coupling of its `kind` is used."""

    signature: U32 = NO_SIGNATURE  # `Bilateral.signature`
    kind: I64 = DIRECT  # DIRECT, PASSIVITY or WAVE
    reserve: F64 = 0.0  # [J] of the coupling
    confidence: Annotated[ConfidenceConfig, Field(record_dtype(ConfidenceConfig))]
    passivity: Annotated[PassivityConfig, Field(record_dtype(PassivityConfig))]
    wave: Annotated[WaveConfig, Field(record_dtype(WaveConfig))]


def bilateral_settings(bilateral: Bilateral) -> Records:
    """Return a `Bilateral` as an array of one `BilateralSettings`."""
    coupling = bilateral.coupling
    settings = BilateralSettings.array()
    settings["signature"] = bilateral.signature
    settings["kind"] = KINDS[type(coupling)]
    settings["reserve"] = coupling.reserve
    settings["confidence"] = as_records(bilateral.confidence)
    settings["passivity"] = as_records(
        coupling if isinstance(coupling, PassivityConfig) else PassivityConfig()
    )
    settings["wave"] = as_records(coupling if isinstance(coupling, WaveConfig) else WaveConfig())
    return settings


@compiled
def differs(settings: BilateralSettings, signature: int) -> bool:
    """Return whether the peer's `signature` belongs to other settings than these."""
    if signature == NO_SIGNATURE:
        return False
    return signature != settings.signature


@lru_cache(maxsize=8)
def _signature(bilateral: Bilateral) -> int:
    return zlib.crc32(repr(bilateral).encode()) or 1
