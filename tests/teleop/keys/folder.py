"""Folders of keys for tests."""

from cryptography.hazmat.primitives.serialization import Encoding

from teleop.security.authority import Authority
from teleop.security.credentials import build_file_stem
from teleop.security.identity import RIGHTS, CertificateRole, Identity
from teleop.security.key_files import write_file, write_key


def put(authority, folder, identity, days=1.0, start=None, name=""):
    """Issue a certificate into a folder, under the name of its holder or of another."""
    certificate, key = authority.issue(identity, days, start)
    path = folder / f"{name or build_file_stem(identity.role, identity.session)}.pem"
    write_file(path, certificate.public_bytes(Encoding.PEM), 0o644)
    write_key(path.with_suffix(".key"), key)
    return path


def make_keys(folder, session="test", authority=None):
    """A folder of keys of all roles, of an authority of its own unless one is given."""
    authority = authority or Authority.create("test authority", 2)
    authority.publish(folder)
    for role in CertificateRole:
        rights = RIGHTS if role is CertificateRole.SUPERVISOR else ()
        put(authority, folder, Identity(role, session, rights))
    return folder
