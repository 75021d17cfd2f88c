"""Endpoints and transport security of the link."""

import ipaddress
import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

_ENDPOINT = re.compile(
    r"(?P<protocol>tcp|tls)/(?:\[(?P<v6>[^\]]+)\]|(?P<host>[^:/\[\]]+)):(?P<port>\d+)"
)
_HOST_NAME = re.compile(r"(?!-)[A-Za-z0-9-]{1,63}(?:\.[A-Za-z0-9-]{1,63})*")


class Endpoint(NamedTuple):
    """A parsed `protocol/host:port`."""

    protocol: str
    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> "Endpoint":
        """Parse `text`; raises `ValueError`."""
        found = _ENDPOINT.fullmatch(text)
        if found is None:
            raise ValueError("is not an endpoint; allowed: tcp/HOST:PORT or tls/HOST:PORT")
        host, port = found["v6"] or found["host"], int(found["port"])
        if not 1 <= port <= 65535:
            raise ValueError(f"port {port} is out of range; allowed: 1 to 65535")
        address = _address(host)
        if address is None and (found["v6"] or not _HOST_NAME.fullmatch(host)):
            raise ValueError(f"{host!r} is not a host name or IP address")
        if address is not None and (address.is_unspecified or address.is_multicast):
            raise ValueError(f"{host} cannot be connected to; use the address of the machine")
        return cls(found["protocol"], host, port)

    @property
    def loopback(self) -> bool:
        """Whether the endpoint is on this machine."""
        address = _address(self.host)
        return self.host == "localhost" if address is None else address.is_loopback


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None


@dataclass(frozen=True, slots=True, kw_only=True)
class TlsConfig:
    """Mutual TLS: both sides present a certificate of one authority."""

    ca: Path  # PEM, the authority's certificate
    certificate: Path  # PEM, ours; names the host of our endpoint
    key: Path  # PEM, its private key

    def __post_init__(self) -> None:
        for name in ("ca", "certificate", "key"):
            if not getattr(self, name).is_file():
                raise ValueError(f"{name}: no such file")


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkConfig:
    """Endpoints of both sides, the same on every machine of a session.

    The master listens on one and the slave on the other; the master connects to the slave,
    listeners connect to both. With `routers` nobody listens: all connect to the first router of the
    list that answers, and to the next one when it is lost. Not 7447 by default: there is the router of ROS on its machine, and
    every ROS node connects to what is there.
    """

    master: str = "tcp/127.0.0.1:7451"  # the master's endpoint
    slave: str = "tcp/127.0.0.1:7452"  # the slave's endpoint
    routers: tuple[str, ...] = ()  # endpoints of `teleop router`, in place of both
    tls: TlsConfig | None = None  # required off loopback
    insecure_plaintext_off_loopback: bool = False  # anyone on that network may then move the robot

    def __post_init__(self) -> None:
        ends = {f"routers[{i}]": router for i, router in enumerate(self.routers)} or {
            "master": self.master,
            "slave": self.slave,
        }
        for name, end in ends.items():
            try:
                endpoint = Endpoint.parse(end)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from error
            if endpoint.protocol == "tls" and self.tls is None:
                raise ValueError(f"{name}: needs link.tls (ca, certificate, key)")
            if endpoint.protocol == "tcp" and self.tls is not None:
                raise ValueError(f"{name}: must be tls/HOST:PORT, as link.tls is set")
            plain = endpoint.protocol == "tcp" and not endpoint.loopback
            if plain and not self.insecure_plaintext_off_loopback:
                raise ValueError(
                    f"{name}: plain tcp is only allowed on loopback; use tls/HOST:PORT with "
                    "link.tls, or set link.insecure_plaintext_off_loopback: true on an isolated "
                    "network"
                )
        if self.master == self.slave:
            raise ValueError("slave: must differ from the endpoint of the master")
