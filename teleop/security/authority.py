"""A private authority: it issues the certificates of its sessions, and revokes them.

Keys are Ed25519 (RFC 8032), certificates X.509. All of an authority lies in one folder:

    authority.key   its private key, readable by its owner only; needed to issue and to revoke
    authority.pem   its certificate, on every machine
    revoked.pem     the list of revoked certificates, signed, on every machine
"""

from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from teleop.errors import UsageError
from teleop.security.identity import Identity
from teleop.security.key_files import load_certificate, load_key, write_file, write_key
from teleop.security.revocation import BACKDATING, REVOKED, build_revocation_list, load_revoked

AUTHORITY_DAYS = 3650
CERTIFICATE_DAYS = 90
AUTHORITY, AUTHORITY_KEY = "authority.pem", "authority.key"
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

    def save(self, folder: Path) -> None:
        """Write the authority, with its private key, into `folder`, which its owner alone reads."""
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        write_key(folder / AUTHORITY_KEY, self.key)
        self.publish(folder)

    def publish(self, folder: Path) -> None:
        """Write what every machine needs: the authority's certificate and the revoked ones."""
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        write_file(folder / AUTHORITY, self.certificate.public_bytes(Encoding.PEM), 0o644)
        revoked = build_revocation_list(self.certificate, self.key, self.revoked)
        write_file(folder / REVOKED, revoked, 0o644)


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
