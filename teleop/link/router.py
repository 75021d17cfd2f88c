"""A Zenoh router with our settings, and who comes and goes through it."""

import json
from collections.abc import Callable
from typing import Any, Self

import zenoh

from teleop.link.config import LinkConfig
from teleop.link.network import config_of, open_session, settings
from teleop.link.presence import Stage, Token, root
from teleop.topics import Role

Presence = Callable[[str, Role, bool], None]
"""Called with a session, a role, and whether a process of it has come, or else gone."""


class Router:
    """A router, as a context manager: forwards between the processes of all sessions.

    It forwards bytes unread, only to who subscribes to their key. Keys begin with the session, so
    nothing crosses from one session to another.

    Parameters
    ----------
    config : LinkConfig
        Protection of the wire.
    listen, connect : list of str
        Endpoints of this router, and of others, which are tried until they answer.
    on_presence : callable
        Called from Zenoh's thread.

    Raises
    ------
    UsageError
        On entering: an endpoint cannot be listened on.
    """

    def __init__(
        self, config: LinkConfig, listen: list[str], connect: list[str], on_presence: Presence
    ) -> None:
        self._arguments = config, listen, connect
        self._on_presence = on_presence

    def __enter__(self) -> Self:
        self._zenoh: Any = open_router(*self._arguments)
        self._watch: Any = self._zenoh.liveliness().declare_subscriber(
            f"{root('*')}/**", self._on_token, history=True
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
        if token is not None and token.stage == Stage.HELD and not token.relayed:
            came = sample.kind == zenoh.SampleKind.PUT
            self._on_presence(key.split("/", 2)[1], token.role, came)


def open_router(config: LinkConfig, listen: list[str], connect: list[str]) -> zenoh.Session:
    """Open a router that listens on some endpoints and connects to other routers.

    Raises
    ------
    UsageError
        An endpoint cannot be listened on.
    """
    return open_session(config, listen, connect, "router")


def zenohd_config(config: LinkConfig, listen: list[str], connect: list[str]) -> str:
    """Return the same settings as the config file of `zenohd`, Zenoh's own router."""
    whole = json.loads(str(config_of(settings(config, listen, connect, "router"))))
    return json.dumps({key: value for key, value in whole.items() if value is not None}, indent=2)
