"""The config file's shared keys, for every process of a session."""

import argparse
import re
from dataclasses import dataclass, field, replace

from teleop.config.arm import ArmConfig, find_space_joints
from teleop.config.loading import ConfigDocument
from teleop.config.overrides import Override
from teleop.config.ranges import build_ranged_field, check_ranges
from teleop.coupling.config import Bilateral, CouplingConfig
from teleop.coupling.force_attenuation import ConfidenceConfig
from teleop.coupling.passivity import PassivityConfig
from teleop.errors import UsageError
from teleop.link.config import LinkConfig
from teleop.link.health import HealthConfig
from teleop.runtime.realtime import RealtimeConfig
from teleop.session import running_sessions

RATE_MIN_HZ, RATE_MAX_HZ = 100.0, 4000.0
SESSION_NAME_MAX = 40  # characters: with a role, the 64 of a certificate's common name
ENDPOINT_KEYS = frozenset({"master", "slave", "routers"})  # of `link`
# least timeout in periods of the link, to tolerate a lost message and jitter
TIMEOUT_PERIODS_MIN = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class RunConfig:
    """Name, rate, link and arms of a session."""

    session: str = "demo"  # root of every key; separates sessions on one network
    # of the link and the slave, and of the master's device; 100 to 4000
    rate_hz: float = build_ranged_field(1000.0, RATE_MIN_HZ, RATE_MAX_HZ, "Hz")
    link: LinkConfig = field(default_factory=LinkConfig)
    health: HealthConfig = field(default_factory=HealthConfig)  # bounds of the link
    arms: tuple[ArmConfig, ...] = ()  # of several joints each: the first of the rig
    realtime: RealtimeConfig = field(default_factory=RealtimeConfig)  # of both loops

    def __post_init__(self) -> None:
        check_ranges(self)
        try:
            check_session(self.session)
        except ValueError as error:
            raise ValueError(f"session: {error}") from error


@dataclass(frozen=True, slots=True, kw_only=True)
class SideConfig(RunConfig):
    """What master and slave share besides.

    Not for any other process: a stop, a view or a recorder needs no code of another package.
    """

    confidence: ConfidenceConfig = field(default_factory=ConfidenceConfig)  # in the force felt
    coupling: CouplingConfig = field(default_factory=PassivityConfig)  # of hand and tip

    @property
    def bilateral(self) -> Bilateral:
        """The settings that both sides share; `UsageError` if an arm cannot be read."""
        return Bilateral(self.confidence, self.coupling, find_space_joints(self.arms))


def check_session(name: str) -> None:
    """Raise `ValueError` if `name` cannot be that of a session."""
    if not re.fullmatch(rf"[a-z0-9_-]{{1,{SESSION_NAME_MAX}}}", name):
        raise ValueError(f"allowed are 1 to {SESSION_NAME_MAX} of a-z 0-9 _ -")


def has_stated_endpoints(document: ConfigDocument) -> bool:
    """Return whether a config says where the processes of a session meet."""
    link = document.tree.get("link")
    return isinstance(link, dict) and not ENDPOINT_KEYS.isdisjoint(link)


def read_config(args: argparse.Namespace, join: bool = True) -> ConfigDocument:
    """Read the config that a command line names.

    A command with `--session` joins a running session of this user on this machine, unless `join`
    is false or the config or options state endpoints: the session's name and endpoints are added.

    Raises `UsageError` if the config cannot be read, there is no such session, or it is not said
    which of several.
    """
    document = ConfigDocument.read(args.config, args.overrides)
    if join and hasattr(args, "session") and not has_stated_endpoints(document):
        running = _find_running_overrides(args, document)
        document = replace(document, overrides=(*running, *document.overrides))
    if getattr(args, "session", None):
        document = document.override(Override.from_value("session", args.session))
    return document


def _find_running_overrides(
    args: argparse.Namespace, document: ConfigDocument
) -> tuple[Override, ...]:
    """Return the overrides of the running session that a command line means, if there is one."""
    stated = document.tree.get("session")
    name = args.session or (stated if isinstance(stated, str) else "")
    entry = running_sessions.find_session(name, args.config)
    if entry is not None:
        return tuple(Override.from_value(key, value) for key, value in entry.place.items())
    if args.session and args.config is None:
        entries = running_sessions.list_sessions()
        names = running_sessions.format_session_names(entries) or "none"
        raise UsageError(
            f"--session {args.session}: no such session of yours runs on this machine; running: "
            f"{names}. For a session on other machines add --config FILE"
        )
    return ()


def require_periods(key: str, timeout_s: float, rate_hz: float) -> None:
    """Check that a timeout [s] is at least `TIMEOUT_PERIODS_MIN` periods; `key` is its dotted key.

    Raises `UsageError` with the least value.
    """
    timeout_min = TIMEOUT_PERIODS_MIN / rate_hz
    if timeout_s < timeout_min * (1.0 - 1e-9):
        raise UsageError(
            f"{key}: {timeout_s:g}: must be at least {TIMEOUT_PERIODS_MIN} periods of rate_hz "
            f"({timeout_min:g} s at {rate_hz:g} Hz)"
        )
