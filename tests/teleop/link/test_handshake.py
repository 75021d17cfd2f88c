"""Whose tokens are believed: each kind of wrong certificate is refused in words."""

import random
from datetime import UTC, datetime, timedelta

import pytest

from teleop.messages.messages import LAYOUT
from teleop.messages.topics import Role
from teleop.security import CertificateError, CertificateRole, Credentials, Identity
from teleop.security.authority import Authority
from teleop.security.handshake import Handshake
from teleop.security.presence import RoleStage, Token

MASTER, SLAVE = Identity(CertificateRole.MASTER, "test"), Identity(CertificateRole.SLAVE, "test")
TOKEN = Token(Role.MASTER, LAYOUT, 7, RoleStage.HELD)
NOW = datetime.now(UTC)


def of(authority, identity, days=1.0, start=None):
    certificate, key = authority.issue(identity, days, start)
    return Credentials(identity, certificate, key, authority.certificate, authority.revoked)


def token_of(credentials):
    return Handshake(credentials, "test", TOKEN.nonce).prove(TOKEN)


def test_each_wrong_certificate_is_refused_in_words_and_the_right_one_is_not():
    authority = Authority.create("ours", 2)
    revoked = of(authority, MASTER)
    authority = authority.revoke(revoked.certificate.serial_number)
    slave = Handshake(of(authority, SLAVE), "test", 1)
    viewer, router = (
        MASTER._replace(role=role) for role in (CertificateRole.VIEWER, CertificateRole.ROUTER)
    )
    for credentials, complaint in (
        (of(authority, MASTER, -0.5, NOW - timedelta(days=1)), r"master\.test expired on"),
        (of(authority, MASTER, 1.0, NOW + timedelta(hours=1)), r"valid from .* check the clock"),
        (revoked, r"master\.test was revoked"),
        (of(authority, viewer), r"master with the certificate viewer\."),
        (of(authority, router), r"master with the certificate router\."),
        (of(authority, MASTER._replace(session="other")), r"master of session 'other'"),
        (of(Authority.create("theirs", 2), MASTER), r"master\.test is of another authority"),
    ):
        with pytest.raises(CertificateError, match=complaint):
            slave.check(token_of(credentials))
    right = of(authority, MASTER)
    peer = slave.check(token_of(right))
    assert (peer.identity, slave.fault, slave.find_fault(peer)) == (MASTER, "", "")
    master = Handshake(right, "test", 7)
    ours = slave.derive_pair_keys(slave.check(master.prove(TOKEN)))
    theirs = master.derive_pair_keys(
        master.check(slave.prove(Token(Role.SLAVE, LAYOUT, 1, RoleStage.HELD)))
    )
    assert (ours.sending, ours.receiving) == (theirs.receiving, theirs.sending)


@pytest.mark.parametrize("seed", range(2))
def test_no_mutated_certificate_is_believed(seed):
    """Each byte in turn, under a signature by the right key over what is shown."""
    authority, chance = Authority.create("ours", 2), random.Random(seed)  # noqa: S311
    slave, master = Handshake(of(authority, SLAVE), "test", 1), of(authority, MASTER)
    genuine = Handshake(master, "test", TOKEN.nonce)
    slave.check(genuine.prove(TOKEN))
    der = genuine._certificate
    for place in range(len(der)):
        changed = bytearray(der)
        changed[place] ^= chance.randint(1, 255)
        if seed % 2:  # and cut off, or longer
            changed[chance.randrange(len(der)) :] = chance.randbytes(chance.randint(0, 40))
        if changed == der:
            continue
        genuine._certificate = bytes(changed)
        with pytest.raises(CertificateError):
            slave.check(genuine.prove(TOKEN))
