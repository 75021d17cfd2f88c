"""Name and endpoints of a session on one machine, so that no two sessions collide."""

import dataclasses
import json
import secrets
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from teleop.config.loading import as_tree, read_stated_keys
from teleop.errors import PeerError, TeleopError
from teleop.impair.config import ImpairConfig
from teleop.session.config import RunConfig, has_stated_endpoints
from teleop.session.running_sessions import RunningSession, create_session_name, list_sessions
from teleop.view.local_server import LOOPBACK, find_free_port

# below the ports that Linux gives to outgoing connections (32768 ...), so that none of those takes
# a port between this choice and the start of the process that listens there
FIRST_PORT, PORTS = 20000, 12000
_DEFAULT_NAME = "demo"


def choose_overrides(config: Path | None, overrides: Sequence[str], name: str | None) -> list[str]:
    """Return overrides that give a session a place of its own on this machine.

    That is free endpoints on loopback, unless config or overrides state endpoints, and then, unless
    they or `name` give it one, a session name of its own after the config file.

    Raises
    ------
    PeerError
        A session of this user has the name already.
    """
    chosen = [f"session={json.dumps(name)}"] if name else []
    if has_stated_endpoints(config, overrides):
        return chosen
    stated = read_stated_keys(config, [*overrides, *chosen])
    if "session" in stated:
        _require_new_session(stated["session"])
    else:
        chosen.append(f"session={create_session_name(config.stem if config else _DEFAULT_NAME)}")
    impair = stated.get("impair")
    keys = ["link.master", "link.slave"]
    if isinstance(impair, dict) and "endpoint" not in impair:
        keys.append("impair.endpoint")
    ports = find_free_ports(len(keys))
    chosen += [f"{k}={LOOPBACK}:{p}" for k, p in zip(keys, ports, strict=True)]
    return chosen


def build_entry(
    shared: RunConfig, impair: ImpairConfig | None, config: Path | None
) -> RunningSession:
    """Return the entry of a session in the registry."""
    link = as_tree(make_paths_absolute(shared.link))
    overrides = [f"session={shared.session}", f"link={json.dumps(link)}"]
    if impair is not None:
        overrides.append(f"impair.endpoint={impair.endpoint}")
    path = "" if config is None else str(config.absolute())
    return RunningSession(
        session=shared.session,
        overrides=tuple(overrides),
        endpoints=shared.link.routers or (shared.link.master, shared.link.slave),
        config=path,
    )


def find_free_ports(count: int) -> list[int]:
    """Return different ports that nobody listens at on loopback; `TeleopError` if it is down."""
    require_loopback()
    for _ in range(100):
        ports = {find_free_port(FIRST_PORT + secrets.randbelow(PORTS)) for _ in range(count)}
        if len(ports) == count:
            return list(ports)
    raise TeleopError(f"no {count} free ports on {LOOPBACK}")


def require_loopback() -> None:
    """Raise `TeleopError` if nothing can be connected to on loopback."""
    with socket.socket() as listener, socket.socket() as caller:
        caller.settimeout(1.0)
        try:
            listener.bind((LOOPBACK, 0))
            listener.listen()
            caller.connect(listener.getsockname())
        except OSError as error:
            raise TeleopError(
                f"{LOOPBACK} cannot be connected to: {error.strerror or error}; bring the loopback "
                "interface up (ip link set lo up)"
            ) from error


def make_paths_absolute(config: Any) -> Any:
    """Return a config with its paths absolute, for a process in another folder."""
    changes = {}
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if isinstance(value, Path):
            changes[field.name] = value.absolute()
        elif dataclasses.is_dataclass(value):
            changes[field.name] = make_paths_absolute(value)
    return dataclasses.replace(config, **changes)


def _require_new_session(session: object) -> None:
    for entry in list_sessions():
        if entry.session == session:
            raise PeerError(
                f"session {session!r} is running already (process {entry.pid}); stop that one "
                "first, or choose another name with --session"
            )
