"""A private authority: it issues the certificates of its sessions, and revokes them.

Keys are Ed25519 (RFC 8032), certificates X.509. All of an authority lies in one folder:

    authority.key   its private key, readable by its owner only; needed to issue and to revoke
    authority.pem   its certificate, on every machine
    revoked.pem     the list of revoked certificates, signed, on every machine
"""

import contextlib
import os
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from functools import lru_cache
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.utils import CryptographyDeprecationWarning
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from teleop.errors import UsageError
from teleop.runtime.files import read_small_file
from teleop.security.identity import Identity

AUTHORITY_DAYS = 3650
CERTIFICATE_DAYS = 90
AUTHORITY, AUTHORITY_KEY, REVOKED = "authority.pem", "authority.key", "revoked.pem"
FILE_MAX = 1_000_000  # [B] of a file of keys; a list of 10 000 revoked certificates has half
BACKDATING = timedelta(hours=1)  # for clocks that are behind
UNREADABLE_ERRORS = (  # what `cryptography` raises for certificates, lists and keys that are none
    ValueError, TypeError, UnsupportedAlgorithm, CryptographyDeprecationWarning,
    x509.InvalidVersion, x509.DuplicateExtension, x509.UnsupportedGeneralNameType,
)  # fmt: skip
_SERVER_NAME = "teleop.invalid"  # never compared: certificates name a role, not a host


@dataclass(frozen=True, slots=True)
class Authority:
    """An authority with its private key."""

    certificate: x509.Certificate
    key: Ed25519PrivateKey
    revoked: frozenset[int] = frozenset()  # serial numbers

    @classmethod
    def create(
        cls, name: str, days: float = AUTHORITY_DAYS, start: datetime | None = None
    ) -> "Authority":
        """Make an authority whose certificate is valid for `days` from `start` (now)."""
        key = Ed25519PrivateKey.generate()
        subject = _build_name(name)
        basic = _build_certificate(subject, subject, key.public_key(), days, start)
        certificate = (
            basic.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_build_key_usage(sign_certificates=True), critical=True)
            .sign(key, None)
        )
        return cls(certificate, key)

    @classmethod
    def load(cls, folder: Path) -> "Authority":
        """Load an authority; `UsageError` if its private key is not there."""
        certificate = load_certificate(folder / AUTHORITY)
        key = load_key(folder / AUTHORITY_KEY)
        if key.public_key() != certificate.public_key():
            raise UsageError(f"{folder / AUTHORITY_KEY}: is not the key of {AUTHORITY}")
        return cls(certificate, key, load_revoked(folder, certificate))

    def issue(
        self, identity: Identity, days: float = CERTIFICATE_DAYS, start: datetime | None = None
    ) -> tuple[x509.Certificate, Ed25519PrivateKey]:
        """Return a new certificate of `identity`, and its private key."""
        key = Ed25519PrivateKey.generate()
        subject = _build_name(identity.common_name)
        basic = _build_certificate(subject, self.certificate.subject, key.public_key(), days, start)
        usages = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
        certificate = (
            basic.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_build_key_usage(sign_certificates=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(usages), critical=False)
            .add_extension(
                x509.SubjectAlternativeName([x509.DNSName(_SERVER_NAME)]), critical=False
            )
            .sign(self.key, None)
        )
        return certificate, key

    def revoke(self, serial: int) -> "Authority":
        """Return the authority with one more certificate revoked."""
        return replace(self, revoked=self.revoked | {serial})

    def build_revocation_list(self) -> bytes:
        """Return the signed list of revoked certificates, as PEM."""
        now = datetime.now(UTC)
        builder = (
            x509.CertificateRevocationListBuilder()
            .issuer_name(self.certificate.subject)
            .last_update(now - BACKDATING)
            .next_update(self.certificate.not_valid_after_utc)
        )
        for serial in sorted(self.revoked):
            entry = x509.RevokedCertificateBuilder().serial_number(serial).revocation_date(now)
            builder = builder.add_revoked_certificate(entry.build())
        return builder.sign(self.key, None).public_bytes(Encoding.PEM)

    def save(self, folder: Path) -> None:
        """Write the authority, with its private key, into `folder`, which its owner alone reads."""
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        write_key(folder / AUTHORITY_KEY, self.key)
        self.publish(folder)

    def publish(self, folder: Path) -> None:
        """Write what every machine needs: the authority's certificate and the revoked ones."""
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        write_file(folder / AUTHORITY, self.certificate.public_bytes(Encoding.PEM), 0o644)
        write_file(folder / REVOKED, self.build_revocation_list(), 0o644)


def load_certificate(path: Path) -> x509.Certificate:
    """Load a certificate; `UsageError` if there is none, or others could replace it."""
    try:
        return x509.load_pem_x509_certificate(
            _read_file(path, 0o022, "change this file; chmod 644")
        )
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}; see `teleop keys --help`") from error
    except UNREADABLE_ERRORS as error:
        raise UsageError(f"{path}: not a certificate (PEM)") from error


def load_key(path: Path) -> Ed25519PrivateKey:
    """Load a private key; `UsageError` if there is none, or others could read it."""
    try:
        data = _read_file(path, 0o077, "read this private key; chmod 600")
        key = load_pem_private_key(data, None)
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}; see `teleop keys --help`") from error
    except UNREADABLE_ERRORS as error:
        raise UsageError(f"{path}: not a private key (PEM, not encrypted)") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise UsageError(f"{path}: not an Ed25519 key; issue it with `teleop keys issue`")
    return key


def load_revoked(folder: Path, authority: x509.Certificate) -> frozenset[int]:
    """Return the revoked serial numbers of a folder; `UsageError` if their list is not genuine."""
    path = folder / REVOKED
    try:
        revoked = x509.load_pem_x509_crl(_read_file(path, 0o022, "change this file; chmod 644"))
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


def require_unshared_folder(folder: Path) -> None:
    """Raise `UsageError` if other users could exchange the files of a folder."""
    status = folder.stat()
    if status.st_mode & 0o022:
        raise UsageError(f"{folder}: other users can change this folder; chmod go-w {folder}")
    _require_owner(folder, status)


def _read_file(path: Path, forbidden: int, complaint: str) -> bytes:
    """Return the content of a file that nobody else owns, nor has `forbidden` permissions for."""

    def check(status: os.stat_result) -> None:
        if status.st_mode & forbidden:
            raise UsageError(f"{path}: other users can {complaint} {path}")
        _require_owner(path, status)

    return read_small_file(path, FILE_MAX, check)


def _require_owner(path: Path, status: os.stat_result) -> None:
    """Raise `UsageError` if a file is neither ours nor the administrator's, who may use all."""
    ours = os.geteuid()
    if ours not in (0, status.st_uid) and status.st_uid != 0:
        raise UsageError(f"{path}: belongs to another user; copy it, so that it is yours")


@lru_cache(maxsize=256)  # a process looks at the same few certificates again and again
def is_signed_by(certificate: x509.Certificate, authority: x509.Certificate) -> bool:
    """Return whether `authority` has issued `certificate`."""
    try:
        certificate.verify_directly_issued_by(authority)
    except (*UNREADABLE_ERRORS, InvalidSignature):
        return False
    return True


def write_key(path: Path, key: Ed25519PrivateKey) -> None:
    """Write a private key, readable by its owner only."""
    write_file(path, key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()), 0o600)


def write_file(path: Path, data: bytes, mode: int) -> None:
    """Write a file with these permissions, whole or not at all."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    with contextlib.suppress(FileNotFoundError):
        partial.unlink()
    try:
        handle = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(handle)
        partial.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            partial.unlink()  # it may hold a part of a private key
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from error


def _build_name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _build_certificate(
    subject: x509.Name,
    issuer: x509.Name,
    key: Ed25519PublicKey,
    days: float,
    start: datetime | None,
) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - BACKDATING if start is None else start)
        .not_valid_after(now + timedelta(days=days))
    )


def _build_key_usage(sign_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=True,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=sign_certificates,
        crl_sign=sign_certificates,
        encipher_only=False,
        decipher_only=False,
    )
