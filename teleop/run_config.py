"""The config file's shared keys, for every process of a session."""

import argparse
import re
from dataclasses import dataclass, field
from typing import Protocol, TypeVar, runtime_checkable

from teleop.config import load
from teleop.coupling.config import Bilateral, CouplingConfig
from teleop.coupling.passivity import PassivityConfig
from teleop.errors import UsageError
from teleop.force_attenuation import ConfidenceConfig
from teleop.link.config import LinkConfig
from teleop.link_health import HealthConfig
from teleop.realtime import RealtimeConfig

T = TypeVar("T")

RATE_MIN_HZ, RATE_MAX_HZ = 100.0, 4000.0
PERIODS = 3  # least timeout in periods of the link, to tolerate a lost message and jitter


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConfig:
    """Name, rate, link and coupling of a session; `teleop.config.load(path, RunConfig, None)`."""

    session: str = "demo"  # root of every key; separates sessions on one network
    rate_hz: float = (
        1000.0  # [Hz] of the link and the slave, and of the master's device; 100 to 4000
    )
    link: LinkConfig = field(default_factory=LinkConfig)
    confidence: ConfidenceConfig = field(default_factory=ConfidenceConfig)  # in the force felt
    coupling: CouplingConfig = field(default_factory=PassivityConfig)  # of hand and tip
    health: HealthConfig = field(default_factory=HealthConfig)  # bounds of the link
    realtime: RealtimeConfig = field(default_factory=RealtimeConfig)  # of both loops

    @property
    def bilateral(self) -> Bilateral:
        """The settings of the coupling that both sides share."""
        return Bilateral(self.confidence, self.coupling)

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z0-9_-]{1,64}", self.session):
            raise ValueError("session: allowed are 1 to 64 of a-z 0-9 _ -")
        if not RATE_MIN_HZ <= self.rate_hz <= RATE_MAX_HZ:
            raise ValueError(f"rate_hz: must be within {RATE_MIN_HZ:g} ... {RATE_MAX_HZ:g} [Hz]")


@runtime_checkable
class RateChecked(Protocol):
    """A config section with values to be checked against the rate."""

    def check_rate(self, rate_hz: float) -> None:
        """Raise `UsageError` if a value of this section conflicts with `rate_hz` [Hz]."""


def load_section(args: argparse.Namespace, cls: type[T], section: str) -> tuple[RunConfig, T]:
    """Return the shared keys and one section of the config that a command line names.

    `UsageError` if they cannot be, or do not go with each other.
    """
    shared = load(args.config, RunConfig, None, args.overrides)
    config = load(args.config, cls, section, args.overrides)
    if isinstance(config, RateChecked):
        config.check_rate(shared.rate_hz)
    return shared, config


def require_periods(key: str, timeout_s: float, rate_hz: float) -> None:
    """Check that a timeout [s] is at least `PERIODS` of the link; `key` is its dotted key.

    Raises
    ------
    UsageError
        With the least value.
    """
    least = PERIODS / rate_hz
    if timeout_s < least * (1.0 - 1e-9):
        raise UsageError(
            f"{key}: {timeout_s:g}: must be at least {PERIODS} periods of rate_hz "
            f"({least:g} s at {rate_hz:g} Hz)"
        )
