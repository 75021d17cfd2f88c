"""What every process of a session must agree on: the config file's shared keys."""

import re
from dataclasses import dataclass, field

from teleop.link.config import LinkConfig


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConfig:
    """The session's name, its rate and its link; `teleop.config.load(path, RunConfig, None)`."""

    session: str = "demo"  # root of every key: sessions on one network do not hear each other
    rate_hz: float = 1000.0  # [Hz] of both control loops; 200 to 8000
    link: LinkConfig = field(default_factory=LinkConfig)

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z0-9_-]{1,64}", self.session):
            raise ValueError("session: allowed are 1 to 64 of a-z 0-9 _ -")
        if not 200.0 <= self.rate_hz <= 8000.0:
            raise ValueError(
                "rate_hz: allowed are 200 to 8000 Hz; the gates take no tick for longer than 5 ms"
            )
