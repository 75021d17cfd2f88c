"""Files of certificates and private keys: read and written so that no other user can meddle."""

import contextlib
import os
from functools import lru_cache
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.utils import CryptographyDeprecationWarning
from cryptography.x509.oid import NameOID

from teleop.errors import TeleopError, UsageError
from teleop.runtime.files import read_small_file

FILE_MAX = 1_000_000  # [B] of a file of keys; a list of 10 000 revoked certificates has half
NAME_MAX = 64  # characters of a common name (X.520)
UNREADABLE_ERRORS = (  # what `cryptography` raises for certificates, lists and keys that are none
    ValueError, TypeError, UnsupportedAlgorithm, CryptographyDeprecationWarning,
    x509.InvalidVersion, x509.DuplicateExtension, x509.UnsupportedGeneralNameType,
)  # fmt: skip


class CertificateError(TeleopError):
    """A certificate that is not believed; the message says why."""


class NotYetValidError(CertificateError):
    """A certificate that will be believed later, or as soon as a clock is set."""


def load_certificate(path: Path) -> x509.Certificate:
    """Load a certificate; `UsageError` if there is none, or others could replace it."""
    try:
        return x509.load_pem_x509_certificate(
            read_key_file(path, 0o022, "change this file; chmod 644")
        )
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}; see `teleop keys --help`") from error
    except UNREADABLE_ERRORS as error:
        raise UsageError(f"{path}: not a certificate (PEM)") from error


def load_key(path: Path) -> Ed25519PrivateKey:
    """Load a private key; `UsageError` if there is none, or others could read it."""
    try:
        data = read_key_file(path, 0o077, "read this private key; chmod 600")
        key = load_pem_private_key(data, None)
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}; see `teleop keys --help`") from error
    except UNREADABLE_ERRORS as error:
        raise UsageError(f"{path}: not a private key (PEM, not encrypted)") from error
    if not isinstance(key, Ed25519PrivateKey):
        raise UsageError(f"{path}: not an Ed25519 key; issue it with `teleop keys issue`")
    return key


def require_unshared_folder(folder: Path) -> None:
    """Raise `UsageError` if other users could exchange the files of a folder."""
    status = folder.stat()
    if status.st_mode & 0o022:
        raise UsageError(f"{folder}: other users can change this folder; chmod go-w {folder}")
    _require_owner(folder, status)


def read_key_file(path: Path, forbidden: int, complaint: str) -> bytes:
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


def read_common_name(certificate: x509.Certificate) -> str:
    """Return the common name of a certificate, which anybody may have made, fit for a terminal."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    if not names:
        return "without a name"
    return "".join(c if c.isprintable() else "?" for c in str(names[0].value))[:NAME_MAX]
