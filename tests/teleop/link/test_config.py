"""Where a link may listen, and what it must not send in the clear."""

from pathlib import Path

import pytest

from teleop.link import LinkConfig, TlsConfig
from teleop.link.config import Endpoint


@pytest.mark.parametrize(
    ("text", "endpoint", "loopback"),
    [
        ("tcp/127.0.0.1:7447", ("tcp", "127.0.0.1", 7447), True),
        ("tcp/127.8.9.1:1", ("tcp", "127.8.9.1", 1), True),
        ("tcp/localhost:65535", ("tcp", "localhost", 65535), True),
        ("tls/[::1]:7447", ("tls", "::1", 7447), True),
        ("tls/console.lab.example:7447", ("tls", "console.lab.example", 7447), False),
        ("tcp/192.168.1.2:7447", ("tcp", "192.168.1.2", 7447), False),
        ("tcp/127.0.0.1.example.org:7447", ("tcp", "127.0.0.1.example.org", 7447), False),
    ],
)
def test_endpoints(text: str, endpoint: tuple[str, str, int], loopback: bool) -> None:
    assert Endpoint.parse(text) == endpoint
    assert Endpoint.parse(text).loopback == loopback


@pytest.mark.parametrize(
    "text",
    [
        "", "127.0.0.1:7447", "udp/127.0.0.1:7447", "tcp/127.0.0.1", "tcp/127.0.0.1:0",
        "tcp/127.0.0.1:65536", "tcp/:7447", "tcp/::1:7447", "tcp/[::1:7447", "tcp/[localhost]:7447",
        "tcp/0.0.0.0:7447", "tcp/[::]:7447", "tcp/224.0.0.1:7447", "tcp/a b:7447", "tcp/-a:7447",
        "tcp/127.0.0.1:7447;tcp/10.0.0.1:7447", "tcp/127.0.0.1:7447#iface=eth0", "tcp/*:7447",
    ],
)  # fmt: skip
def test_bad_endpoints_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"endpoint|port|host|connected"):
        Endpoint.parse(text)
    with pytest.raises(ValueError, match=r"^slave: "):
        LinkConfig(slave=text)


def test_plaintext_never_leaves_the_machine_unasked(tmp_path: Path) -> None:
    with pytest.raises(
        ValueError, match=r"^slave: plain tcp is only allowed on loopback.*link\.tls"
    ):
        LinkConfig(slave="tcp/192.168.1.2:7448")
    with pytest.raises(ValueError, match=r"^master: plain tcp is only allowed on loopback"):
        LinkConfig(master="tcp/rig.lab:7447")
    asked = LinkConfig(slave="tcp/192.168.1.2:7448", insecure_plaintext_off_loopback=True)
    assert asked.slave.startswith("tcp/192")
    with pytest.raises(ValueError, match=r"^slave: needs link\.tls"):
        LinkConfig(slave="tls/192.168.1.2:7448")
    for name in ("ca", "certificate", "key"):
        (tmp_path / name).touch()
    tls = TlsConfig(ca=tmp_path / "ca", certificate=tmp_path / "certificate", key=tmp_path / "key")
    with pytest.raises(ValueError, match=r"^master: must be tls"):
        LinkConfig(slave="tls/192.168.1.2:7448", tls=tls, insecure_plaintext_off_loopback=True)
    LinkConfig(master="tls/192.168.1.1:7447", slave="tls/192.168.1.2:7448", tls=tls)


def test_missing_certificates_and_twice_the_same_endpoint_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"^ca: no such file"):
        TlsConfig(ca=tmp_path / "no", certificate=tmp_path / "no", key=tmp_path / "no")
    with pytest.raises(ValueError, match=r"^slave: must differ from the endpoint"):
        LinkConfig(master="tcp/127.0.0.1:7000", slave="tcp/127.0.0.1:7000")
