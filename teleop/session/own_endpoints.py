"""Name and endpoints of a session on one machine, so that no two sessions collide."""

import dataclasses
import secrets
import socket
from pathlib import Path
from typing import Any

from teleop.config.loading import ConfigDocument, as_tree
from teleop.config.overrides import Override
from teleop.errors import PeerError, TeleopError
from teleop.impair.config import ImpairConfig
from teleop.session.config import RunConfig, has_stated_endpoints
from teleop.session.running_sessions import RunningSession, create_session_name, list_sessions
from teleop.view.local_server import LOOPBACK, find_free_port

# below the ports that Linux gives to outgoing connections (32768 ...), so that none of those takes
# a port between this choice and the start of the process that listens there
FIRST_PORT, PORTS = 20000, 12000
_DEFAULT_NAME = "demo"


def choose_place(document: ConfigDocument, name: str | None) -> ConfigDocument:
    """Return the config of a session with a place of its own on this machine.

    That is free endpoints on loopback, unless the config states endpoints, and then, unless it or
    `name` gives it one, a session name of its own after the config file.

    Raises `PeerError` if a session of this user has the name already.
    """
    if name:
        document = document.override(Override.from_value("session", name))
    if has_stated_endpoints(document):
        return document
    chosen, stated = {}, document.tree
    if "session" in stated:
        for entry in list_sessions():
            if entry.session == stated["session"]:
                raise PeerError(
                    f"session {entry.session!r} is running already (process {entry.pid}); stop "
                    "that one first, or choose another name with --session"
                )
    else:
        base = document.path.stem if document.path else _DEFAULT_NAME
        chosen["session"] = create_session_name(base)
    keys = ["link.master", "link.slave"]
    if isinstance(stated.get("impair"), dict) and "endpoint" not in stated["impair"]:
        keys.append("impair.endpoint")
    ports = find_free_ports(len(keys))
    chosen |= {key: f"{LOOPBACK}:{port}" for key, port in zip(keys, ports, strict=True)}
    return document.override(*(Override.from_value(key, value) for key, value in chosen.items()))


def build_entry(
    shared: RunConfig, impair: ImpairConfig | None, config: Path | None
) -> RunningSession:
    """Return the entry of a session in the registry."""
    place = {"session": shared.session, "link": as_tree(make_paths_absolute(shared.link))}
    if impair is not None:
        place["impair.endpoint"] = impair.endpoint
    return RunningSession(
        session=shared.session,
        place=place,
        endpoints=shared.link.routers or (shared.link.master, shared.link.slave),
        config="" if config is None else str(config.absolute()),
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
