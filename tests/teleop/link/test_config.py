"""Where a link may listen, and what it must not send in the clear."""

import re
import subprocess
import sys

import pytest

from teleop.link import LinkConfig
from teleop.link.config import Address, Endpoint


@pytest.mark.parametrize(
    ("text", "address", "loopback"),
    [
        ("127.0.0.1:7447", ("127.0.0.1", 7447), True),
        ("127.8.9.1:1", ("127.8.9.1", 1), True),
        ("localhost:65535", ("localhost", 65535), True),
        ("[::1]:7447", ("::1", 7447), True),
        ("console.lab.example:7447", ("console.lab.example", 7447), False),
        ("192.168.1.2:7447", ("192.168.1.2", 7447), False),
        ("127.0.0.1.example.org:7447", ("127.0.0.1.example.org", 7447), False),
    ],
)
def test_addresses(text, address, loopback):
    assert Address.parse(text) == address
    assert Address.parse(text).loopback == loopback


@pytest.mark.parametrize(
    "text",
    [
        "", "127.0.0.1", "127.0.0.1:0", "127.0.0.1:65536", ":7447", "::1:7447", "[::1:7447",
        "[localhost]:7447", "0.0.0.0:7447", "[::]:7447", "224.0.0.1:7447", "a b:7447", "-a:7447",
        "127.0.0.1:7447;10.0.0.1:7447", "127.0.0.1:7447#iface=eth0", "*:7447", "ws/127.0.0.1:7447",
    ],
)  # fmt: skip
def test_bad_addresses_are_refused(text):
    with pytest.raises(ValueError, match=r"address|port|host|connected"):
        Address.parse(text)
    with pytest.raises(ValueError, match=r"^slave: "):
        LinkConfig(slave=text)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[fe80::1]:7447", "fe80::1 is link-local, it would need a zone; use an IPv4 address"),
        ("fe80::1:7447", "write an IPv6 address in brackets, and a port"),
        ("2001:db8::1", "write an IPv6 address in brackets, and a port"),
        ("[2001:db8::1]", "write an IPv6 address in brackets, and a port"),
        ("192.168.1.999:7447", "'192.168.1.999' is not a host name or IP address"),
    ],
)
def test_an_address_that_cannot_be_connected_to_is_refused_with_what_to_write(text, said):
    with pytest.raises(ValueError, match=f"^{re.escape(said)}"):
        Address.parse(text)


def test_a_zone_is_refused_with_the_reason():
    with pytest.raises(ValueError, match=r"^slave: a zone \(%eth0\) is not possible"):
        LinkConfig(slave="[fe80::1%eth0]:7447")


def test_a_router_of_ros_has_its_protocol():
    assert Endpoint.parse("tcp/127.0.0.1:7447") == ("tcp", "127.0.0.1", 7447)
    for text in ("127.0.0.1:7447", "udp/127.0.0.1:7447", "tcp/127.0.0.1"):
        with pytest.raises(ValueError, match=r"endpoint|address"):
            Endpoint.parse(text)


def test_off_loopback_keys_are_needed_unless_asked_otherwise(tmp_path):
    for change in ({"slave": "192.168.1.2:7448"}, {"master": "rig.lab:7447"}):
        (name,) = change
        with pytest.raises(ValueError, match=rf"^{name}: off loopback, link\.keys must"):
            LinkConfig(**change)
        LinkConfig(**change, insecure=True)
        LinkConfig(**change, keys=tmp_path)


def test_twice_the_same_endpoint_is_refused():
    with pytest.raises(ValueError, match=r"^slave: must differ from the endpoint"):
        LinkConfig(master="127.0.0.1:7000", slave="127.0.0.1:7000")


FEW_FILES = """
import resource, sys
from teleop.errors import UsageError
from teleop.link.network import open_session
soft, hard = map(int, sys.argv[1:])
resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
try:
    open_session(None, [], []).close()
except UsageError as error:
    print(error)
"""


@pytest.mark.slow
def test_a_process_that_listens_may_open_as_many_files_as_its_user():
    """Strangers take one for each connection."""
    code = FEW_FILES.replace("[], []", "['127.0.0.1:0'], []")
    code += "print(resource.getrlimit(resource.RLIMIT_NOFILE))"
    words = [sys.executable, "-c", code, "100", "5000"]
    run = subprocess.run(words, capture_output=True, text=True, check=True, timeout=60)
    assert (run.stdout, run.stderr) == ("(5000, 5000)\n", "")


@pytest.mark.parametrize(
    ("limits", "said"),
    [(("20", "24"), "this process may open 24 files only; allow it 64: ulimit -n 64\n"),
     pytest.param(("20", "1000"), "", marks=pytest.mark.slow)],
)  # fmt: skip
def test_where_few_files_may_be_open_a_link_is_refused_or_allowed_more(limits, said):
    words = [sys.executable, "-c", FEW_FILES, *limits]
    run = subprocess.run(words, capture_output=True, text=True, check=True, timeout=60)
    assert (run.stdout, run.stderr) == (said, "")
