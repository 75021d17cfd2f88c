"""The `router` section of a config file."""

from dataclasses import dataclass

from teleop.link.config import Address

DEFAULT = "127.0.0.1:7450"  # where a router listens that is told nothing


@dataclass(frozen=True, slots=True)
class RouterConfig:
    """Where a router is met, and which other routers it connects to."""

    listen: tuple[str, ...] = ()  # HOST:PORT of this machine; empty = link.routers
    connect: tuple[str, ...] = ()  # HOST:PORT of other routers, tried until they answer

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        for name in ("listen", "connect"):
            for i, text in enumerate(getattr(self, name)):
                try:
                    Address.parse(text)
                except ValueError as error:
                    raise ValueError(f"{name}[{i}]: {error}") from error
