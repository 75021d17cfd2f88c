"""The `router` section of a config file."""

from dataclasses import dataclass

from teleop.link.config import Address
from teleop.session.config import check_session

ALL = "all"  # sessions: then the router enforces no roles, only that a certificate is ours
DEFAULT_ENDPOINT = "127.0.0.1:7450"  # where a router listens that is told nothing


@dataclass(frozen=True, slots=True)
class RouterConfig:
    """What a router serves, where it is met, and which other routers it connects to."""

    sessions: tuple[str, ...] = ()  # that it serves; empty = the config's; all = any, see `ALL`

    listen: tuple[str, ...] = ()  # HOST:PORT of this machine; empty = link.routers
    connect: tuple[str, ...] = ()  # HOST:PORT of other routers, tried until they answer

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
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
