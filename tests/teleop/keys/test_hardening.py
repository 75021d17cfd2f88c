"""What a bad neighbour on the machine, or a bad certificate, could do to keys."""

import os
import random
import threading
from datetime import UTC, datetime, timedelta

import pytest

from teleop.cli import commands
from teleop.errors import UsageError
from teleop.messages.messages import LAYOUT
from teleop.messages.topics import Role
from teleop.security import CertificateError, credentials, identity, key_files
from teleop.security.authority import Authority, _build_certificate, _build_name
from teleop.security.credentials import create_local_credentials, find_local_folder
from teleop.security.handshake import Handshake
from teleop.security.identity import CertificateRole, Identity
from teleop.security.key_files import write_file
from teleop.security.presence import RoleStage, Token
from teleop.security.revocation import REVOKED
from tests.teleop.keys.folder import make_keys

MASTER = Identity(CertificateRole.MASTER, "test")


@pytest.fixture
def authority():
    return Authority.create("test authority", 2)


def load(folder):
    return credentials.load(folder, "test", CertificateRole.MASTER)


def refusal(folder):
    with pytest.raises(UsageError) as caught:
        load(folder)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_files_that_others_can_change_are_refused_with_the_remedy(tmp_path):
    keys = make_keys(tmp_path / "keys")
    for path in (keys / "authority.pem", keys / REVOKED, keys / "test.master.pem"):
        path.chmod(0o664)
        assert f"other users can change this file; chmod 644 {path}" in refusal(keys)
        path.chmod(0o644)
    keys.chmod(0o777)
    assert f"chmod go-w {keys}" in refusal(keys)
    keys.chmod(0o755)
    load(keys)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file away")
def test_keys_of_another_user_are_refused(tmp_path, monkeypatch):
    keys = make_keys(tmp_path / "keys")
    for path in (keys, *keys.iterdir()):
        os.chown(path, 54321, -1)
    load(keys)  # by the administrator
    monkeypatch.setattr(os, "geteuid", lambda: 54321)
    load(keys)
    monkeypatch.setattr(os, "geteuid", lambda: 12345)
    assert "belongs to another user" in refusal(keys)


def test_a_write_that_fails_leaves_neither_a_part_of_the_key_nor_a_broken_file(
    tmp_path, monkeypatch
):
    path = tmp_path / "a.key"
    write_file(path, b"before", 0o600)
    assert path.stat().st_mode & 0o777 == 0o600

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(key_files.os, "fsync", full)
    with pytest.raises(UsageError, match="No space left"):
        write_file(path, b"after", 0o600)
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_in_the_place_of_a_new_file_is_not_followed(tmp_path):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    for name in ("a.key", f".a.key.{os.getpid()}.partial"):
        (tmp_path / name).symlink_to(victim)
        write_file(tmp_path / "a.key", b"secret", 0o600)
        assert victim.read_text() == "precious"
        assert not (tmp_path / "a.key").is_symlink()
        assert (tmp_path / "a.key").stat().st_mode & 0o777 == 0o600


def test_local_keys_of_many_first_starts_at_once_are_the_same(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    found = []
    threads = [
        threading.Thread(
            target=lambda: found.append(create_local_credentials("a", CertificateRole.MASTER))
        )
        for _ in range(8)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 8
    assert len({one.authority.serial_number for one in found}) == 1
    assert [path.name for path in find_local_folder().parent.iterdir()] == ["keys"]
    assert find_local_folder().parent.stat().st_mode & 0o077 == 0


def test_local_keys_in_a_folder_that_is_a_link_of_somebody_else_are_refused(tmp_path, monkeypatch):
    Authority.create("theirs", 365).save(tmp_path / "theirs")
    (tmp_path / "theirs").chmod(0o755)
    (tmp_path / "teleop").mkdir()
    (tmp_path / "teleop" / "keys").symlink_to(tmp_path / "theirs")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    with pytest.raises(UsageError, match="this user alone"):
        create_local_credentials("a", CertificateRole.MASTER)


def test_an_authority_that_has_expired_ends_its_certificates(authority):
    now = datetime.now(UTC)
    old = Authority.create("old", -0.5, now - timedelta(days=1))
    certificate, _ = old.issue(MASTER, 1.0)
    with pytest.raises(
        CertificateError, match=r"the authority of the certificate master\.test exp"
    ):
        identity.identify_holder(certificate, old.certificate, frozenset())
    certificate, _ = authority.issue(MASTER, 1.0)
    assert identity.identify_holder(certificate, authority.certificate, frozenset()) == MASTER


def test_the_command_refuses_what_would_do_nothing(tmp_path, refused):
    home, out = str(tmp_path / "authority"), tmp_path / "out"
    assert commands.main(["keys", "init", home, "--days", "30"]) == 0
    theirs = make_keys(tmp_path / "theirs")
    issue = ["keys", "issue", home, "--session", "test", "--role", "master", "--out", str(out)]
    for words, complaint in (
        (issue, "--days: the authority itself ends on"),
        (["keys", "revoke", home, str(theirs / "test.master.pem")], "is of another authority"),
        (["keys", "revoke", home, "0"], "not a serial number"),
        (["keys", "revoke", home, "f" * 60], "not a serial number"),
    ):
        assert complaint in refused(*words)


def test_a_name_out_of_a_foreign_certificate_cannot_write_to_the_terminal():
    other = Authority.create("another", 2)
    for name in ("master.test\x1b[2J\r\n", "\u202emaster", "x" * 64):
        basic = _build_certificate(
            _build_name(name), other.certificate.subject, other.key.public_key(), 1, None
        )
        certificate = basic.sign(other.key, None)
        with pytest.raises(CertificateError) as caught:
            identity.identify_holder(
                certificate, Authority.create("ours", 2).certificate, frozenset()
            )
        assert str(caught.value).isprintable()
        assert len(str(caught.value)) < 120


@pytest.mark.parametrize("count", [500, pytest.param(50_000, marks=pytest.mark.slow)])
@pytest.mark.filterwarnings("ignore:Attribute's length")  # of a damaged name
def test_damaged_proofs_are_refused_and_nothing_else(authority, count):
    certificate, key = authority.issue(MASTER)
    ours = credentials.Credentials(MASTER, certificate, key, authority.certificate)
    token = Token(Role.MASTER, LAYOUT, 7, RoleStage.HELD)
    prove = Handshake(ours, "test", 7).prove
    proof, check = prove(token).proof, Handshake(ours, "test", 8).check
    assert check(prove(token)).identity == MASTER
    for junk in ("!", "\n", "=", "A", "."):  # which base64 would skip
        with pytest.raises(CertificateError):
            check(
                Token(Role.MASTER, LAYOUT, 7, RoleStage.HELD, proof=proof[:50] + junk + proof[50:])
            )
    letters = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_"
    chance = random.Random(1)  # noqa: S311
    for _ in range(count):
        text = list(proof)
        for _ in range(chance.randint(1, 3)):
            text[chance.randrange(len(text))] = chance.choice(letters)
        del text[chance.choice((len(text), chance.randrange(len(text)))) :]
        damaged = "".join(text)
        if damaged != proof:
            try:
                check(Token(Role.MASTER, LAYOUT, 7, RoleStage.HELD, proof=damaged))
            except CertificateError as error:
                assert str(error).isprintable()  # noqa: PT017
            else:
                raise AssertionError(damaged)


def test_no_key_is_in_what_is_shown_of_credentials(authority):
    certificate, key = authority.issue(MASTER)
    ours = credentials.Credentials(MASTER, certificate, key, authority.certificate)
    secret = key.private_bytes_raw()
    assert secret.hex() not in repr(ours)
    assert repr(secret)[2:-1] not in repr(ours)
