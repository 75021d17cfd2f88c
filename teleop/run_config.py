"""What every process of a session must agree on: the config file's shared keys."""

import re
from dataclasses import dataclass, field

from teleop.coupling.config import Bilateral, CouplingConfig
from teleop.coupling.passivity import PassivityConfig
from teleop.force_attenuation import ConfidenceConfig
from teleop.link.config import LinkConfig
from teleop.realtime import RealtimeConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConfig:
    """Name, rate, link and coupling of a session; `teleop.config.load(path, RunConfig, None)`."""

    session: str = "demo"  # root of every key: sessions on one network do not hear each other
    rate_hz: float = 1000.0  # [Hz] of both control loops; 200 to 8000
    link: LinkConfig = field(default_factory=LinkConfig)
    confidence: ConfidenceConfig = field(default_factory=ConfidenceConfig)  # in the force felt
    coupling: CouplingConfig = field(default_factory=PassivityConfig)  # of hand and tip
    realtime: RealtimeConfig = field(default_factory=RealtimeConfig)  # of both loops

    @property
    def bilateral(self) -> Bilateral:
        """What both sides must agree on about the force."""
        return Bilateral(self.confidence, self.coupling)

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z0-9_-]{1,64}", self.session):
            raise ValueError("session: allowed are 1 to 64 of a-z 0-9 _ -")
        if not 200.0 <= self.rate_hz <= 8000.0:
            raise ValueError(
                "rate_hz: allowed are 200 to 8000 Hz; the gates take no tick for longer than 5 ms"
            )
