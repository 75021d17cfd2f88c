"""Links with certificates."""

import subprocess
import time
from pathlib import Path

import pytest

from teleop.link import Counts, Link, LinkConfig, TlsConfig
from teleop.messages import Command
from teleop.topics import COMMAND, Role
from tests.teleop.link.bench import pump, session


def openssl(folder: Path, *arguments: str) -> None:
    subprocess.run(["openssl", *arguments], cwd=folder, check=True, capture_output=True)


def make_certificates(folder: Path) -> TlsConfig:
    """An authority, and a certificate of it for 127.0.0.1."""
    folder.mkdir()
    key = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")
    openssl(
        folder, "req", "-x509", *key, "-keyout", "ca.key", "-out", "ca.pem", "-days", "2",
        "-subj", "/CN=test authority",
    )  # fmt: skip
    openssl(folder, "req", *key, "-keyout", "key.pem", "-out", "request.pem", "-subj", "/CN=peer")
    (folder / "names").write_text(
        "subjectAltName=IP:127.0.0.1,DNS:localhost\nextendedKeyUsage=serverAuth,clientAuth\n"
        "basicConstraints=CA:FALSE\n"
    )
    openssl(
        folder, "x509", "-req", "-in", "request.pem", "-CA", "ca.pem", "-CAkey", "ca.key",
        "-CAcreateserial", "-out", "cert.pem", "-days", "2", "-extfile", "names",
    )  # fmt: skip
    return TlsConfig(ca=folder / "ca.pem", certificate=folder / "cert.pem", key=folder / "key.pem")


@pytest.fixture(scope="module")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> tuple[TlsConfig, TlsConfig]:
    """Ours, and those of someone with an authority of his own."""
    folder = tmp_path_factory.mktemp("certificates")
    try:
        return make_certificates(folder / "ours"), make_certificates(folder / "theirs")
    except FileNotFoundError:
        pytest.skip("needs the openssl command")


def over_tls(tls: TlsConfig, like: LinkConfig) -> LinkConfig:
    return LinkConfig(
        master=like.master.replace("tcp", "tls"), slave=like.slave.replace("tcp", "tls"), tls=tls
    )


def test_mutual_tls_lets_our_own_in(
    certificates: tuple[TlsConfig, TlsConfig], config: LinkConfig
) -> None:
    with session(over_tls(certificates[0], config), Role.SLAVE, Role.MASTER) as (slave, master):
        pump(master, slave, 20)


def test_mutual_tls_keeps_out_another_authority_and_plain_tcp(
    certificates: tuple[TlsConfig, TlsConfig], config: LinkConfig
) -> None:
    ours, theirs = certificates
    believes_us = TlsConfig(ca=ours.ca, certificate=theirs.certificate, key=theirs.key)
    with Link(over_tls(ours, config), "test", Role.SLAVE) as slave:
        slave.subscribe_latest(COMMAND)
        for intruder in (over_tls(theirs, config), over_tls(believes_us, config), config):
            with Link(intruder, "test", Role.MASTER) as master:
                for _ in range(100):
                    master.publish(COMMAND, Command())
                    time.sleep(0.003)
                    assert not slave.present(Role.MASTER)
                    assert not master.present(Role.SLAVE)
        assert slave.latest(COMMAND).counts == Counts()
