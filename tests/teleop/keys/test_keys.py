"""Keys: what is issued is believed, and every flaw is named in one line."""

import os
from datetime import UTC, datetime, timedelta

import pytest

from teleop.cli import commands
from teleop.errors import UsageError
from teleop.security import credentials
from teleop.security.authority import Authority
from teleop.security.credentials import create_local_credentials, find_local_folder
from teleop.security.identity import RIGHTS, CertificateRole, Identity, list_supervisor_names
from teleop.security.revocation import load_revoked
from tests.teleop.keys.folder import make_keys, put

MASTER = Identity(CertificateRole.MASTER, "test")


@pytest.fixture
def authority():
    return Authority.create("test authority", 2)


def load(folder, role=CertificateRole.MASTER):
    return credentials.load(folder, "test", role)


@pytest.mark.parametrize("role", list(CertificateRole))
def test_a_name_says_role_session_and_rights(role):
    rights = RIGHTS if role is CertificateRole.SUPERVISOR else ()
    assert Identity.parse(f"{role}.theatre-2") == (role, "theatre-2", rights)
    assert len(Identity(role, "s" * 40, rights[:2]).common_name) <= 64
    for bad in (f"{role}", f"{role}-fly.a", f"{role}.A", f"x{role}.a", f"{role}.a.b"):
        with pytest.raises(ValueError, match=r"."):
            Identity.parse(bad)


def test_a_supervisor_has_the_rights_of_its_name():
    assert Identity.parse("supervisor-stop.a").rights == ("stop",)
    assert set(list_supervisor_names("a", "set")) == {
        "supervisor.a", "supervisor-set.a", "supervisor-reset-set.a", "supervisor-set-stop.a",
    }  # fmt: skip


def test_only_a_router_is_for_all_sessions():
    assert Identity.parse("router.*").may_join("anything")
    with pytest.raises(ValueError, match="only a router"):
        Identity.parse("master.*")


def test_every_flaw_is_named(tmp_path, authority):
    folder = make_keys(tmp_path / "keys", authority=authority)
    now = datetime.now(UTC)
    other = Authority.create("another", 2)
    viewer = MASTER._replace(role=CertificateRole.VIEWER)
    for issuer, identity, days, start, complaint in (
        (authority, MASTER, -0.5, now - timedelta(days=1), r"expired on .* issue a new one"),
        (authority, viewer, 1.0, None, r"viewer, this process is a mas"),
        (other, MASTER, 1.0, None, r"of another authority"),
    ):
        put(issuer, folder, identity, days, start, "test.master")
        with pytest.raises(UsageError, match=complaint) as caught:
            load(folder)
        assert "\n" not in str(caught.value)
    path = put(authority, folder, MASTER)
    load(folder)
    key = path.with_suffix(".key")
    key.chmod(0o640)
    with pytest.raises(UsageError, match=r"other users can read.*chmod 600"):
        load(folder)
    key.unlink()
    with pytest.raises(UsageError, match=r"test\.master\.key: No such file"):
        load(folder)
    path.unlink()
    with pytest.raises(UsageError, match=r"no certificate of a master.*test\.viewer"):
        load(folder)
    with pytest.raises(UsageError, match=r"link\.keys: .*no such folder"):
        load(tmp_path / "nowhere")


def test_a_revoked_certificate_is_refused_and_the_list_must_be_genuine(tmp_path, authority):
    folder = make_keys(tmp_path, authority=authority)
    serial = load(folder).certificate.serial_number
    authority.revoke(serial).publish(folder)
    with pytest.raises(UsageError, match="was revoked"):
        load(folder)
    load(folder, CertificateRole.SLAVE)
    Authority.create("another", 2).publish(tmp_path / "other")
    (folder / "revoked.pem").write_bytes((tmp_path / "other" / "revoked.pem").read_bytes())
    with pytest.raises(UsageError, match="not signed by the authority"):
        load(folder)
    (folder / "revoked.pem").unlink()
    with pytest.raises(UsageError, match=r"revoked\.pem: missing"):
        load(folder)


def test_local_keys_make_themselves_once_and_are_private(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    one = create_local_credentials("a", CertificateRole.MASTER)
    two = create_local_credentials("a", CertificateRole.SLAVE)
    assert two.identify(one.certificate) == Identity(CertificateRole.MASTER, "a")
    assert find_local_folder().stat().st_mode & 0o077 == 0
    life = one.certificate.not_valid_after_utc - datetime.now(UTC)
    assert life <= timedelta(days=7)
    find_local_folder().chmod(0o755)
    with pytest.raises(UsageError, match="this user alone"):
        create_local_credentials("a", CertificateRole.MASTER)


@pytest.mark.skipif(os.geteuid() == 0, reason="root can write everywhere")
def test_no_place_for_local_keys_is_one_line(tmp_path, monkeypatch):
    tmp_path.chmod(0o500)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    with pytest.raises(UsageError, match="set XDG_STATE_HOME"):
        create_local_credentials("a", CertificateRole.MASTER)


def test_the_command_makes_what_a_session_needs(tmp_path, capsys, refused):
    home, out = str(tmp_path / "authority"), tmp_path / "out"
    issue = ["keys", "issue", home, "--session", "test", "--out", str(out)]
    assert commands.main(["keys", "init", home]) == 0
    assert (
        commands.main([*issue, "--role", "master", "--role", "supervisor", "--right", "stop"]) == 0
    )
    assert load(out).identity == MASTER
    assert load(out, CertificateRole.SUPERVISOR).identity.rights == ("stop",)
    assert not (out / "authority.key").exists()
    assert commands.main(["keys", "show", str(out)]) == 0
    assert "supervisor-stop.test, valid until" in capsys.readouterr().out
    assert commands.main(["keys", "revoke", home, str(out / "test.master.pem")]) == 0
    assert len(load_revoked(tmp_path / "authority", load(out).authority)) == 1
    (out / "revoked.pem").write_bytes((tmp_path / "authority" / "revoked.pem").read_bytes())
    with pytest.raises(UsageError, match="revoked"):
        load(out)
    for words, complaint in (
        ([*issue, "--role", "master"], "exists; --force replaces it"),
        ([*issue, "--role", "slave", "--right", "set"], "only for --role supervisor"),
        (["keys", "issue", home, "--session", "all", "--role", "master", "--out", str(out)],
         "only for --role router"),
        (["keys", "issue", home, "--session", "A B", "--role", "master", "--out", str(out)],
         "allowed are"),
        (["keys", "init", home], "has an authority already"),
        (["keys", "revoke", home, "xyz"], "neither a file nor a serial number"),
        (["keys", "show", str(tmp_path)], "No such file"),
    ):  # fmt: skip
        assert complaint in refused(*words)
