"""Endpoints and transport security of the link."""

import ipaddress
import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

_ADDRESS = re.compile(r"(?:\[(?P<v6>[^\]]+)\]|(?P<host>[^:/\[\]]+)):(?P<port>\d+)")
_NUMBERS = re.compile(r"[\d.]+")  # an IPv4 address with a mistake, no name
_NO_ZONE = (
    "use an IPv4 address or another IPv6 address of the machine (`ip addr`), or its name in the "
    "local network (HOST.local)"
)
_HOST_NAME = re.compile(r"(?!-)[A-Za-z0-9-]{1,63}(?:\.[A-Za-z0-9-]{1,63})*")


class Address(NamedTuple):
    """A parsed `HOST:PORT`."""

    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> "Address":
        """Parse `text`; raises `ValueError`."""
        protocol, slash, rest = text.partition("/")
        if slash and protocol in ("tcp", "tls", "quic", "udp"):
            reason = "TLS, or plain TCP with link.insecure, is chosen by itself"
            raise ValueError(f"write {rest} without {protocol}/; {reason}")
        match = _ADDRESS.fullmatch(text)
        if match is None:
            parts = (part.strip("[]") for part in (text, text.rpartition(":")[0]))
            if any(":" in part and _parse_ip_address(part) for part in parts):
                raise ValueError("write an IPv6 address in brackets, and a port: [fd00::1]:7447")
            raise ValueError("is not an address; allowed: HOST:PORT")
        host, port = match["v6"] or match["host"], int(match["port"])
        if not 1 <= port <= 65535:
            raise ValueError(f"port {port} is out of range; allowed: 1 to 65535")
        if "%" in host:  # it is of one machine, and the config the same on all
            zone = host[host.index("%") :]
            raise ValueError(f"a zone ({zone}) is not possible; {_NO_ZONE}")
        address = _parse_ip_address(host)
        is_name = _HOST_NAME.fullmatch(host) and not _NUMBERS.fullmatch(host)
        if address is None and (match["v6"] or not is_name):
            raise ValueError(f"{host!r} is not a host name or IP address")
        if address is not None and address.version == 6 and address.is_link_local:
            raise ValueError(f"{host} is link-local, it would need a zone; {_NO_ZONE}")
        if address is not None and (address.is_unspecified or address.is_multicast):
            raise ValueError(f"{host} cannot be connected to; use the address of the machine")
        return cls(host, port)

    @property
    def loopback(self) -> bool:
        """Whether the address is on this machine."""
        address = _parse_ip_address(self.host)
        return self.host == "localhost" if address is None else address.is_loopback


class Endpoint(NamedTuple):
    """A parsed `protocol/HOST:PORT`, of a router of ROS."""

    protocol: str
    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> "Endpoint":
        """Parse `text`; raises `ValueError`."""
        protocol, _, rest = text.partition("/")
        if protocol not in ("tcp", "tls"):
            raise ValueError("is not an endpoint; allowed: tcp/HOST:PORT or tls/HOST:PORT")
        return cls(protocol, *Address.parse(rest))

    @property
    def loopback(self) -> bool:
        """Whether the endpoint is on this machine."""
        return Address(self.host, self.port).loopback


def _parse_ip_address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkConfig:
    """Endpoints of both sides, the same on every machine of a session, and its protection.

    The master listens on one and the slave on the other; the master connects to the slave,
    listeners connect to both. With `routers` nobody listens: all connect to the first router of the
    list that answers, and to the next one when it is lost. Not 7447 by default: there is the router
    of ROS on its machine, and every ROS node connects to what is there.

    Everything is authenticated and encrypted, on loopback too. Without `keys` the processes of one
    user on one machine make their own (`teleop.security.credentials`).
    """

    master: str = "127.0.0.1:7451"  # HOST:PORT of the master
    slave: str = "127.0.0.1:7452"  # HOST:PORT of the slave
    routers: tuple[str, ...] = ()  # HOST:PORT of `teleop router`, in place of both
    keys: Path | None = None  # folder of `teleop keys issue`; required off loopback
    insecure: bool = False  # plaintext: whoever reaches the endpoints may move the robot

    def __post_init__(self) -> None:
        ends = {f"routers[{i}]": router for i, router in enumerate(self.routers)} or {
            "master": self.master,
            "slave": self.slave,
        }
        for name, end in ends.items():
            try:
                address = Address.parse(end)
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from error
            if not (address.loopback or self.insecure or self.keys is not None):
                raise ValueError(
                    f"{name}: off loopback, link.keys must name a folder of keys (`teleop keys "
                    "--help`), or on an isolated network link.insecure: true"
                )
        if self.master == self.slave:
            raise ValueError("slave: must differ from the endpoint of the master")
