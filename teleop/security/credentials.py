"""The credentials of a process: its certificate, its private key, and whom it trusts.

A folder of credentials holds `authority.pem` and `revoked.pem`, and for each role of each session
that runs on this machine `<session>.<role>.pem` and `<session>.<role>.key`.
"""

import base64
import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from teleop.errors import UsageError
from teleop.runtime.files import find_state_folder
from teleop.security.authority import AUTHORITY, Authority
from teleop.security.identity import (
    ALL_SESSIONS,
    RIGHTS,
    CertificateRole,
    Identity,
    identify_holder,
)
from teleop.security.key_files import (
    CertificateError,
    load_certificate,
    load_key,
    require_unshared_folder,
)
from teleop.security.revocation import load_revoked

EXPIRY_WARNING = timedelta(days=14)  # before a certificate expires


@dataclass(frozen=True, slots=True)
class Credentials:
    """What a process proves its role with, and checks others by."""

    identity: Identity
    certificate: x509.Certificate
    key: Ed25519PrivateKey
    authority: x509.Certificate
    revoked: frozenset[int] = frozenset()
    lasting: bool = True  # issued by a person, who must issue the next one
    folder: Path | None = None  # where the list of revoked certificates lies

    def identify(self, certificate: x509.Certificate) -> Identity:
        """Return whom a certificate stands for; `CertificateError` if it is not to be believed."""
        return identify_holder(certificate, self.authority, self.revoked)

    @property
    def warning(self) -> str:
        """Empty, or that the certificate expires soon."""
        time_left = self.certificate.not_valid_after_utc - datetime.now(UTC)
        if not self.lasting or time_left > EXPIRY_WARNING:
            return ""
        return f"the certificate {self.identity.common_name} expires in {time_left.days} days"

    def build_tls_settings(self) -> dict[str, str]:
        """Return the authority, our certificate and our key as Zenoh's TLS takes them."""
        key = self.key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
        authority, ours = (
            base64.b64encode(certificate.public_bytes(Encoding.PEM)).decode()
            for certificate in (self.authority, self.certificate)
        )
        private = base64.b64encode(key).decode()
        return {
            "root_ca_certificate_base64": authority,
            "listen_certificate_base64": ours,
            "connect_certificate_base64": ours,
            "listen_private_key_base64": private,
            "connect_private_key_base64": private,
        }


def build_file_stem(role: CertificateRole, session: str) -> str:
    """Return the name, without its ending, of the files of a certificate."""
    return f"{'all' if session == ALL_SESSIONS else session}.{role}"


def load(folder: Path, session: str, role: CertificateRole) -> Credentials:
    """Load the credentials of a role in a session.

    Raises `UsageError` if a file is missing or damaged; the private key can be read by others; the
    certificate is not valid now, revoked, or of another authority, session or role.
    """
    if not folder.is_dir():
        raise UsageError(f"link.keys: {folder}: no such folder; see `teleop keys --help`")
    require_unshared_folder(folder)
    authority = load_certificate(folder / AUTHORITY)
    revoked = load_revoked(folder, authority)
    names = [build_file_stem(role, session)]
    if role is CertificateRole.ROUTER:
        names.append(build_file_stem(role, ALL_SESSIONS))
    present = [name for name in names if (folder / f"{name}.pem").is_file()]
    if not present:
        other_names = sorted(path.stem for path in folder.glob("*.*.pem"))
        raise UsageError(
            f"link.keys: {folder}: no certificate of a {role} of session {session!r}"
            f" (there: {', '.join(other_names) or 'none'}); issue one with `teleop keys issue`"
        )
    path = folder / f"{present[0]}.pem"
    certificate, key = load_certificate(path), load_key(path.with_suffix(".key"))
    if key.public_key() != certificate.public_key():
        raise UsageError(f"{path.with_suffix('.key')}: is not the key of {path.name}")
    try:
        identity = identify_holder(certificate, authority, revoked)
    except CertificateError as error:
        raise UsageError(f"{path}: {error}") from error
    if identity.role is not role:
        raise UsageError(f"{path}: is of a {identity.role}, this process is a {role}")
    if not identity.may_join(session):
        raise UsageError(f"{path}: is of session {identity.session!r}, not {session!r}")
    return Credentials(identity, certificate, key, authority, revoked, folder=folder)


# --- credentials without asking, for sessions on one machine
# Each user has an authority, below `$XDG_STATE_HOME/teleop/keys` (default `~/.local/state`),
# readable only by that user. Every process issues itself a certificate that lasts for `LOCAL_DAYS`
# and is kept in memory only. So the processes of one user accept each other, and no others.


LOCAL_DAYS = 7  # longer than any session
AUTHORITY_LIFE_DAYS = 365  # [days]
_EPOCH = datetime(2000, 1, 1, tzinfo=UTC)  # on one machine a clock set back must not matter


def find_local_folder() -> Path:
    """Return the folder of this user's authority."""
    return find_state_folder() / "teleop" / "keys"


def create_local_credentials(session: str, role: CertificateRole) -> Credentials:
    """Return new credentials of a role in a session; `UsageError` if they cannot be kept."""
    authority = _obtain_authority()
    identity = Identity(role, session, RIGHTS if role is CertificateRole.SUPERVISOR else ())
    certificate, key = authority.issue(identity, LOCAL_DAYS, _EPOCH)
    return Credentials(
        identity, certificate, key, authority.certificate, authority.revoked, lasting=False,
        folder=find_local_folder(),
    )  # fmt: skip


def _obtain_authority() -> Authority:
    """Return this user's authority, made if there is none that lasts."""
    folder = find_local_folder()
    try:
        return _load_valid_authority(folder) or _make_authority(folder)
    except OSError as error:
        raise UsageError(
            f"{folder}: no keys can be kept here: {error.strerror}; set XDG_STATE_HOME to a folder "
            "of yours, or link.keys"
        ) from error


def _load_valid_authority(folder: Path) -> Authority | None:
    """Return the authority of a folder; None if there is none, or it expires soon."""
    if not (folder / AUTHORITY).is_file():
        return None
    _require_private_folder(folder)
    authority = Authority.load(folder)
    time_left = authority.certificate.not_valid_after_utc - datetime.now(UTC)
    return authority if time_left > timedelta(days=LOCAL_DAYS) else None


def _make_authority(folder: Path) -> Authority:
    """Make the authority; of several processes at once the first one wins."""
    folder.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    with _lock_folder(folder.parent):
        if (authority := _load_valid_authority(folder)) is not None:  # another process was faster
            return authority
        # a new name, which nobody can have taken before
        draft = Path(tempfile.mkdtemp(prefix=".keys-", dir=folder.parent))
        Authority.create("teleop on this machine", AUTHORITY_LIFE_DAYS, _EPOCH).save(draft / "new")
        if folder.exists():
            folder.rename(draft / "old")
        (draft / "new").rename(folder)
        shutil.rmtree(draft)
        _require_private_folder(folder)
        return Authority.load(folder)


@contextlib.contextmanager
def _lock_folder(folder: Path) -> Iterator[None]:
    """Let one process at a time make an authority in `folder`."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def _require_private_folder(folder: Path) -> None:
    status = folder.stat()
    if status.st_uid != os.geteuid() or status.st_mode & 0o077:
        raise UsageError(f"{folder}: must belong to this user alone; chmod 700 {folder}")
