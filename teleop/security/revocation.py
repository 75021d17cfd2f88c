"""Revoked certificates: their signed list, and the refusal of what stands in it.

`Authority.revoke` adds to the list, `revoked.pem` beside the authority's certificate on every
machine. A process reads it at its start and again whenever it changes, and believes no certificate
that stands in it (`teleop.security.identity.identify_holder`).
"""

from collections.abc import Callable, Iterable
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding

from teleop.errors import UsageError
from teleop.security.key_files import (
    UNREADABLE_ERRORS,
    CertificateError,
    read_common_name,
    read_key_file,
)

REVOKED = "revoked.pem"
BACKDATING = timedelta(hours=1)  # for clocks that are behind


def refuse_revoked(certificate: x509.Certificate, revoked: frozenset[int]) -> None:
    """Raise `CertificateError` if a certificate is among the `revoked` serial numbers."""
    if certificate.serial_number in revoked:
        raise CertificateError(f"the certificate {read_common_name(certificate)} was revoked")


def load_revoked(folder: Path, authority: x509.Certificate) -> frozenset[int]:
    """Return the revoked serial numbers of a folder; `UsageError` if their list is not genuine."""
    path = folder / REVOKED
    try:
        revoked = x509.load_pem_x509_crl(read_key_file(path, 0o022, "change this file; chmod 644"))
    except FileNotFoundError as error:
        raise UsageError(f"{path}: missing; copy it from the folder of the authority") from error
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}") from error
    except UNREADABLE_ERRORS as error:
        raise UsageError(f"{path}: not a list of revoked certificates (PEM)") from error
    public = authority.public_key()
    if not isinstance(public, Ed25519PublicKey) or not revoked.is_signature_valid(public):
        raise UsageError(f"{path}: not signed by the authority beside it")
    return frozenset(entry.serial_number for entry in revoked)


def build_revocation_list(
    authority: x509.Certificate, key: Ed25519PrivateKey, serials: Iterable[int]
) -> bytes:
    """Return the signed list of revoked serial numbers, as PEM."""
    now = datetime.now(UTC)
    builder = (
        x509.CertificateRevocationListBuilder()
        .issuer_name(authority.subject)
        .last_update(now - BACKDATING)
        .next_update(authority.not_valid_after_utc)
    )
    for serial in sorted(serials):
        entry = x509.RevokedCertificateBuilder().serial_number(serial).revocation_date(now)
        builder = builder.add_revoked_certificate(entry.build())
    return builder.sign(key, None).public_bytes(Encoding.PEM)


class RevocationList:
    """What is revoked, by the file in the folder of keys; read again when that changes.

    A certificate that was revoked once stays so in this process. A file that is missing, damaged or
    not signed by the authority changes nothing and is complained about, once.

    `serials` are those at the start. Without a `folder` they stay. The complaint of a list that is
    not `lasting` is left out: its authority, of one user on one machine, is replaced now and then.
    """

    def __init__(
        self,
        folder: Path | None,
        authority: x509.Certificate,
        serials: frozenset[int],
        lasting: bool,
    ) -> None:
        self.serials = serials
        self._folder, self._authority, self._lasting = folder, authority, lasting
        self._seen = self._read_state()

    def update(self, complain: Callable[[str], None]) -> bool:
        """Read the file if it has changed; return whether more certificates are revoked."""
        state, folder = self._read_state(), self._folder
        if state == self._seen or folder is None:
            return False
        self._seen = state
        try:
            revoked = load_revoked(folder, self._authority)
        except UsageError as error:
            if self._lasting:
                complain(f"a list of revoked certificates: {error}; the earlier one stays in force")
            return False
        grown = not revoked <= self.serials
        self.serials |= revoked
        return grown

    def _read_state(self) -> tuple[int, ...]:
        """Return what changes with the file."""
        if self._folder is None:
            return ()
        try:
            status = (self._folder / REVOKED).stat()
        except OSError:
            return (0,)
        return status.st_mtime_ns, status.st_size, status.st_ino
