"""A Zenoh router with our settings, and who comes and goes through it."""

import json
from collections.abc import Callable, Sequence
from typing import Any, Self

import zenoh

from teleop.errors import UsageError
from teleop.link.config import LinkConfig
from teleop.link.network import build_settings, open_session
from teleop.link.protection import load_credentials
from teleop.messages.topics import Role
from teleop.security import CertificateRole, Credentials
from teleop.security.access import build_access_control
from teleop.security.authority import AUTHORITY
from teleop.security.credentials import build_file_stem
from teleop.security.identity import ALL_SESSIONS
from teleop.security.presence import RoleStage, Token, build_token_root

PresenceCallback = Callable[[str, Role, bool], None]
"""Called with a session, a role, and whether a process of it has come, or else gone."""


class Router:
    """A router, as a context manager: forwards between the processes of all sessions.

    It forwards bytes unread, only to who subscribes to their key. Keys begin with the session, so
    nothing crosses from one session to another.

    Parameters
    ----------
    config : LinkConfig
        Protection of the wire.
    sessions : sequence of str
        Names of the sessions that it serves, by the roles in their certificates; `ALL_SESSIONS` for
        any, whatever their roles.
    listen, connect : tuple of str
        `HOST:PORT` of this router, and of others, which are tried until they answer.
    on_presence : callable
        Called from Zenoh's thread.

    Raises
    ------
    UsageError
        On entering: there are no valid keys of a router; an endpoint cannot be listened on.
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

    @property
    def neighbours(self) -> int:
        """Number of other routers connected to this one."""
        return len(self._zenoh.info.routers_zid())

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

    Raises
    ------
    UsageError
        There are no valid keys of a router; an endpoint cannot be listened on.
    """
    credentials = load_credentials(config, ALL_SESSIONS, CertificateRole.ROUTER)
    access = _build_access_control(credentials, sessions)
    return open_session(credentials, listen, connect, access, "router")


def format_zenohd_config(
    config: LinkConfig, sessions: Sequence[str], listen: list[str], connect: list[str]
) -> str:
    """Return the settings of `open_router` as a config file of `zenohd`, Zenoh's own router.

    Raises
    ------
    UsageError
        There is no folder of valid keys, which such a file must name.
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
