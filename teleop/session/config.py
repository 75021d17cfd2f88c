"""The config file's shared keys, for every process of a session."""

import argparse
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, TypeVar, runtime_checkable

from teleop.config.loading import load, read_stated_keys
from teleop.coupling.config import Bilateral, CouplingConfig
from teleop.coupling.force_attenuation import ConfidenceConfig
from teleop.coupling.passivity import PassivityConfig
from teleop.errors import UsageError
from teleop.link.config import LinkConfig
from teleop.link.health import HealthConfig
from teleop.runtime.realtime import RealtimeConfig
from teleop.session import running_sessions

T = TypeVar("T")

RATE_MIN_HZ, RATE_MAX_HZ = 100.0, 4000.0
SESSION_NAME_MAX = 40  # characters: with a role, the 64 of a certificate's common name
ENDPOINT_KEYS = frozenset({"master", "slave", "routers"})  # of `link`
# least timeout in periods of the link, to tolerate a lost message and jitter
TIMEOUT_PERIODS_MIN = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConfig:
    """Name, rate, link and coupling of a session; `load(path, RunConfig, None)`."""

    session: str = "demo"  # root of every key; separates sessions on one network
    # [Hz] of the link and the slave, and of the master's device; 100 to 4000
    rate_hz: float = 1000.0
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
        try:
            check_session(self.session)
        except ValueError as error:
            raise ValueError(f"session: {error}") from error
        if not RATE_MIN_HZ <= self.rate_hz <= RATE_MAX_HZ:
            raise ValueError(f"rate_hz: must be within {RATE_MIN_HZ:g} ... {RATE_MAX_HZ:g} [Hz]")


def check_session(name: str) -> None:
    """Raise `ValueError` if `name` cannot be that of a session."""
    if not re.fullmatch(rf"[a-z0-9_-]{{1,{SESSION_NAME_MAX}}}", name):
        raise ValueError(f"allowed are 1 to {SESSION_NAME_MAX} of a-z 0-9 _ -")


@runtime_checkable
class RateCheckedSection(Protocol):
    """A config section with values to be checked against the rate."""

    def check_rate(self, rate_hz: float) -> None:
        """Raise `UsageError` if a value of this section conflicts with `rate_hz` [Hz]."""


def has_stated_endpoints(config: Path | None, overrides: Sequence[str]) -> bool:
    """Return whether a config file or overrides say where the processes of a session meet."""
    link = read_stated_keys(config, overrides).get("link")
    return isinstance(link, dict) and not ENDPOINT_KEYS.isdisjoint(link)


def load_shared(args: argparse.Namespace, join: bool = True) -> RunConfig:
    """Return the shared keys of the config that a command line names.

    A command with `--session` joins a running session of this user on this machine, unless `join`
    is false or the config or options state endpoints: the session's name and endpoints are added to
    `args.overrides`.

    Raises
    ------
    UsageError
        The config is invalid, there is no such session, or it is not said which of several.
    """
    join = join and hasattr(args, "session")
    if join and not has_stated_endpoints(args.config, args.overrides):
        args.overrides = [*_find_running_overrides(args), *args.overrides]
    if getattr(args, "session", None):
        args.overrides = [*args.overrides, f"session={json.dumps(args.session)}"]
    return load(args.config, RunConfig, None, args.overrides)


def _find_running_overrides(args: argparse.Namespace) -> tuple[str, ...]:
    """Return the overrides of the running session that a command line means, if there is one."""
    stated = read_stated_keys(args.config, args.overrides).get("session")
    name = args.session or (stated if isinstance(stated, str) else "")
    entry = running_sessions.find_session(name, args.config)
    if entry is not None:
        return entry.overrides
    if args.session and args.config is None:
        entries = running_sessions.list_sessions()
        names = running_sessions.format_session_names(entries) or "none"
        raise UsageError(
            f"--session {args.session}: no such session of yours runs on this machine; running: "
            f"{names}. For a session on other machines add --config FILE"
        )
    return ()


def load_section(
    args: argparse.Namespace, cls: type[T], section: str, join: bool = True
) -> tuple[RunConfig, T]:
    """Return the shared keys and one section of the config that a command line names.

    `UsageError` if they cannot be, or do not go with each other; see `load_shared`.
    """
    shared = load_shared(args, join)
    config = load(args.config, cls, section, args.overrides)
    if isinstance(config, RateCheckedSection):
        config.check_rate(shared.rate_hz)
    return shared, config


def require_periods(key: str, timeout_s: float, rate_hz: float) -> None:
    """Check that a timeout [s] is at least `TIMEOUT_PERIODS_MIN` periods; `key` is its dotted key.

    Raises
    ------
    UsageError
        With the least value.
    """
    timeout_min = TIMEOUT_PERIODS_MIN / rate_hz
    if timeout_s < timeout_min * (1.0 - 1e-9):
        raise UsageError(
            f"{key}: {timeout_s:g}: must be at least {TIMEOUT_PERIODS_MIN} periods of rate_hz "
            f"({timeout_min:g} s at {rate_hz:g} Hz)"
        )
