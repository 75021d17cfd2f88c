"""Settings of the bilateral coupling that both sides must share."""

import zlib
from collections.abc import Sequence
from functools import lru_cache
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import jit_compile
from estimator.structs import (
    F64,
    I64,
    U32,
    Field,
    Struct,
    StructArray,
    build_struct_dtype,
    to_struct_array,
)
from teleop.coupling.direct import DirectConfig
from teleop.coupling.extension import CouplingExtension
from teleop.coupling.force_attenuation import ConfidenceConfig
from teleop.coupling.passivity import PassivityConfig
from teleop.coupling.wave import WaveConfig
from teleop.messages.messages import MAX_JOINTS

CouplingConfig = PassivityConfig | WaveConfig | DirectConfig | CouplingExtension

NO_SIGNATURE = 0
DIRECT, PASSIVITY, WAVE, EXTENSION = range(4)
KINDS: dict[type[Any], int] = {DirectConfig: DIRECT, PassivityConfig: PASSIVITY, WaveConfig: WAVE}


class Bilateral(NamedTuple):
    """The force attenuation and the coupling that both sides use."""

    confidence: ConfidenceConfig = ConfidenceConfig()
    coupling: CouplingConfig = DirectConfig()
    arms: Sequence[tuple[int, int]] = ()  # first joint and number of joints of arms in space

    @property
    def signature(self) -> int:
        """Non-zero hash of these settings; each side sends its own."""
        return _compute_signature(self)


class BilateralSettings(Struct):
    """A `Bilateral` for compiled functions; only the coupling of its `kind` is used."""

    signature: U32 = NO_SIGNATURE  # `Bilateral.signature`
    kind: I64 = DIRECT  # DIRECT, PASSIVITY, WAVE or EXTENSION
    reserve: F64 = 0.0  # [J] of the coupling
    confidence: Annotated[ConfidenceConfig, Field(build_struct_dtype(ConfidenceConfig))]
    # of each joint, the arm in space that it belongs to, or -1
    arm: Annotated[NDArray[np.int64], Field("i8", MAX_JOINTS, fill=-1)]
    passivity: Annotated[PassivityConfig, Field(build_struct_dtype(PassivityConfig))]
    wave: Annotated[WaveConfig, Field(build_struct_dtype(WaveConfig))]


def to_bilateral_settings(bilateral: Bilateral) -> StructArray:
    """Return a `Bilateral` as an array of one `BilateralSettings`."""
    coupling = bilateral.coupling
    settings = BilateralSettings.array()
    settings["signature"] = bilateral.signature
    settings["kind"] = KINDS.get(type(coupling), EXTENSION)
    settings["reserve"] = coupling.reserve
    settings["confidence"] = to_struct_array(bilateral.confidence)
    for number, (first, joints) in enumerate(bilateral.arms):
        settings["arm"][0, first : first + joints] = number
    settings["passivity"] = to_struct_array(
        coupling if isinstance(coupling, PassivityConfig) else PassivityConfig()
    )
    settings["wave"] = to_struct_array(
        coupling if isinstance(coupling, WaveConfig) else WaveConfig()
    )
    return settings


@jit_compile
def has_settings_mismatch(settings: BilateralSettings, signature: int) -> bool:
    """Return whether the peer's `signature` belongs to other settings than these."""
    if signature == NO_SIGNATURE:
        return False
    return signature != settings.signature


@lru_cache(maxsize=8)
def _compute_signature(bilateral: Bilateral) -> int:
    return zlib.crc32(repr(bilateral).encode()) or 1
