"""Run a router: one place where the processes of many sessions meet.

  teleop router                                       on this machine, at 127.0.0.1:7450
  teleop router --session room-1 --session room-2 --listen 10.0.0.5:7450 --keys router-keys
  teleop router --config ward.yaml                    at `link.routers` of the sessions' config
  teleop router --listen 192.0.2.1:7450 --connect 198.51.100.1:7450 --keys router-keys

Master, slave, recorder and viewer of a session then connect to the router, not to each other: only
the router's port must be open, and a machine behind a firewall or NAT needs no port at all:

  link:
    routers: ["10.0.0.5:7450"]     # several: the first that answers, and the next when it is lost
    keys: console-keys

Any number of sessions share a router (`router.sessions`, or `--session` for each; by default the
config's). Their names keep them apart: every key begins with the name, and a router forwards a
message only to who subscribes to its key, and only if the certificate of its sender may send it: a
viewer's sends no commands, and what is of no session named is refused. `--session all` serves any
session, and leaves the roles to the processes themselves. A second master or slave of a session is
refused as without a router.

Routers connect to each other with `--connect`: one on each side of a wide-area network, so that
each site goes on talking within itself when the line is cut.

Off loopback a router needs keys of its own, which prove to every process that it is yours:

  teleop keys issue authority --session all --role router --out router-keys

It says which processes come and go. It must be there when they start; when it is started again they
come back by themselves, into holding, never into motion. See docs/how-to/network.md.
"""

import argparse
import dataclasses
import json
import queue
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import zenoh

from teleop.config.loading import ConfigDocument
from teleop.config.options import add_option, add_options
from teleop.errors import UsageError
from teleop.link.config import Address, LinkConfig
from teleop.link.network import build_settings, load_credentials, open_session
from teleop.messages.topics import Role, format_role
from teleop.runtime.process import StopCondition, write_summary
from teleop.runtime.realtime import request_realtime
from teleop.security import CertificateRole, Credentials
from teleop.security.access import build_access_control
from teleop.security.authority import AUTHORITY
from teleop.security.credentials import build_file_stem
from teleop.security.identity import ALL_SESSIONS
from teleop.security.presence import RoleStage, Token, build_token_root
from teleop.session.config import RunConfig, check_session

# --- the `router` section of a config file

ALL = "all"  # sessions: then the router enforces no roles, only that a certificate is ours
DEFAULT_ENDPOINT = "127.0.0.1:7450"  # where a router listens that is told nothing


@dataclass(frozen=True, slots=True)
class RouterConfig:
    """What a router serves, where it is met, and which other routers it connects to."""

    sessions: tuple[str, ...] = ()  # that it serves; empty = the config's; all = any

    listen: tuple[str, ...] = ()  # HOST:PORT of this machine; empty = link.routers
    connect: tuple[str, ...] = ()  # HOST:PORT of other routers, tried until they answer

    def __post_init__(self) -> None:
        for i, session in enumerate(self.sessions):
            try:
                check_session(session)
            except ValueError as error:
                raise ValueError(f"sessions[{i}]: {error}") from error
        for name in ("listen", "connect"):
            for i, text in enumerate(getattr(self, name)):
                try:
                    Address.parse(text)
                except ValueError as error:
                    raise ValueError(f"{name}[{i}]: {error}") from error


PresenceCallback = Callable[[str, Role, bool], None]
"""Called with a session, a role, and whether a process of it has come, or else gone."""


class Router:
    """A router, as a context manager: forwards between the processes of all sessions.

    It forwards bytes unread, only to who subscribes to their key. Keys begin with the session, so
    nothing crosses from one session to another.

    It serves `sessions` by the roles in their certificates; with `ALL_SESSIONS` any, whatever their
    roles. `listen` and `connect` are `HOST:PORT`s of this router, and of others, which are tried
    until they answer; Zenoh's thread calls `on_presence`. Raises `UsageError` on entering, as
    `open_router`.
    """

    def __init__(
        self,
        config: LinkConfig,
        sessions: Sequence[str],
        listen: Sequence[str],
        connect: Sequence[str],
        on_presence: PresenceCallback = lambda *_: None,
    ) -> None:
        self._arguments = config, sessions, list(listen), list(connect)
        self._on_presence = on_presence

    def __enter__(self) -> Self:
        self._zenoh: Any = open_router(*self._arguments)
        self._watch: Any = self._zenoh.liveliness().declare_subscriber(
            f"{build_token_root('*')}/**", self._on_token, history=True
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._watch.undeclare()
        self._zenoh.close()

    def _on_token(self, sample: Any) -> None:
        key = str(sample.key_expr)
        token = Token.from_key(key)
        if token is not None and token.stage == RoleStage.HELD and not token.relayed:
            came = sample.kind == zenoh.SampleKind.PUT
            self._on_presence(key.split("/", 2)[1], token.role, came)


def open_router(
    config: LinkConfig, sessions: Sequence[str], listen: list[str], connect: list[str]
) -> zenoh.Session:
    """Open a router that listens on some endpoints and connects to other routers.

    It forwards only what the certificate of its sender permits in these sessions; for
    `ALL_SESSIONS`, whatever a certificate of the authority sends.

    Raises `UsageError` if there are no valid keys of a router, or an endpoint cannot be listened
    on.
    """
    credentials = load_credentials(config, ALL_SESSIONS, CertificateRole.ROUTER)
    access = _build_access_control(credentials, sessions)
    return open_session(credentials, listen, connect, access, "router")


def format_zenohd_config(
    config: LinkConfig, sessions: Sequence[str], listen: list[str], connect: list[str]
) -> str:
    """Return the settings of `open_router` as a config file of `zenohd`, Zenoh's own router.

    Raises `UsageError` if there is no folder of valid keys, which such a file must name.
    """
    if config.keys is None and not config.insecure:
        raise UsageError("link.keys: zenohd needs a folder of keys; see `teleop keys --help`")
    credentials = load_credentials(config, ALL_SESSIONS, CertificateRole.ROUTER)
    flat = build_settings(
        credentials, listen, connect, _build_access_control(credentials, sessions), "router"
    )
    if credentials is not None and config.keys is not None:
        name = build_file_stem(CertificateRole.ROUTER, credentials.identity.session)
        own, key = (str(config.keys / f"{name}.{end}") for end in ("pem", "key"))
        flat["transport/link/tls"] = {
            "enable_mtls": True,
            "verify_name_on_connect": False,
            "close_link_on_expiration": True,
            "root_ca_certificate": str(config.keys / AUTHORITY),
            "listen_certificate": own,
            "listen_private_key": key,
            "connect_certificate": own,
            "connect_private_key": key,
        }
    return json.dumps(_nest_settings(flat), indent=2)


def _build_access_control(
    credentials: Credentials | None, sessions: Sequence[str]
) -> dict[str, Any] | None:
    open_to_all = credentials is None or ALL_SESSIONS in sessions
    return None if open_to_all else build_access_control(sessions)


def _nest_settings(flat: dict[str, Any]) -> dict[str, Any]:
    """Return settings by their path, such as `connect/endpoints`, as a tree."""
    tree: dict[str, Any] = {}
    for path, value in flat.items():
        *folders, name = path.split("/")
        node = tree
        for folder in folders:
            node = node.setdefault(folder, {})
        node[name] = value
    return tree


# --- the command


_POLL_S = 0.1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop router`."""
    add_option(
        parser,
        "--session",
        action="append",
        default=[],
        help="served, may be repeated (default router.sessions or the config's); all = any",
    )
    for name, text in (
        (
            "--listen",
            f"of this machine, may be repeated (default link.routers, or {DEFAULT_ENDPOINT})",
        ),
        ("--connect", "of another router, may be repeated"),
    ):
        parser.add_argument(name, action="append", default=[], metavar="HOST:PORT", help=text)
    parser.add_argument("--keys", type=Path, metavar="DIR", help="folder of its keys (link.keys)")
    parser.add_argument(
        "--zenohd", action="store_true", help="print these settings as a config of zenohd, and end"
    )
    add_options(parser, "--config", "--set", "--insecure", "--duration", "--json")


def main(args: argparse.Namespace) -> int:
    """Run the router until told to stop; returns the exit code."""
    document = ConfigDocument.read(args.config, args.overrides)
    shared = document.load(RunConfig)
    config = build_router_config(args, shared, document.load(RouterConfig, "router"))
    link = build_router_link(shared.link, config, args.keys)
    sessions = [ALL_SESSIONS if name == ALL else name for name in config.sessions]
    if args.zenohd:
        print(format_zenohd_config(link, sessions, list(config.listen), list(config.connect)))
        return 0
    stop = StopCondition(args.duration)
    # before the router: its threads inherit the priority
    granted = request_realtime(shared.realtime)
    # no `SimpleQueue`, whose waits may have no end (`teleop.link.reception.Inbox.wait`)
    changes: queue.Queue[tuple[str, Role, bool]] = queue.Queue()
    seen: set[str] = set()
    with Router(link, sessions, config.listen, config.connect, lambda *change: changes.put(change)):
        print(_format_start_message(config, link), flush=True)
        while not stop():
            try:
                session, role, came = changes.get(timeout=_POLL_S)
            except queue.Empty:
                continue
            seen.add(session)
            print(
                f"session {session}: {format_role(role)} {'joined' if came else 'left'}", flush=True
            )
    summary = {"sessions": sorted(seen), "stopped": stop.reason, "realtime": granted}
    write_summary(args.json, summary)
    print(f"router ended ({stop.reason}): {len(seen)} sessions seen")
    return 0


def build_router_config(
    args: argparse.Namespace, shared: RunConfig, config: RouterConfig
) -> RouterConfig:
    """Return what the router serves and where, by options, config or defaults.

    `UsageError` if an option is wrong.
    """
    try:
        return RouterConfig(
            sessions=tuple(args.session) or config.sessions or (shared.session,),
            listen=tuple(args.listen)
            or config.listen
            or shared.link.routers
            or (DEFAULT_ENDPOINT,),
            connect=tuple(args.connect) or config.connect,
        )
    except ValueError as error:
        raise UsageError(f"--{error}") from error


def build_router_link(link: LinkConfig, config: RouterConfig, keys: Path | None) -> LinkConfig:
    """Return the link of the router; `UsageError` if it must have keys and has none."""
    ends = (*config.listen, *config.connect)
    try:
        return dataclasses.replace(link, routers=ends, keys=keys or link.keys)
    except ValueError as error:
        raise UsageError(f"router: {str(error).partition(': ')[2]}") from error


def _format_start_message(config: RouterConfig, link: LinkConfig) -> str:
    ends = ", ".join(config.listen)
    text = f'router at {ends}; sessions find it by link.routers: ["{config.listen[0]}"]'
    text += f"; serves {', '.join(config.sessions)}"
    if config.connect:
        text += f"; connects to {', '.join(config.connect)}"
    return text + ("; INSECURE: plaintext, no keys" if link.insecure else "")
