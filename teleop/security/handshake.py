"""The proof of a presence token, and the keys of a pair of processes that follow from it.

A token ends with a *proof*: the certificate of its process, an X25519 public key drawn at its
start, and a signature by the certificate's key over both and everything else in the token. So a
token cannot be made, or changed, without the private key of a certificate. From the two public
keys each pair of processes derives its keys, one for each direction (Diffie and Hellman, RFC
7748; HKDF, RFC 5869). They are bound to both nonces, so they are new whenever one of the two
processes is: no message of an earlier run passes.

The proof is `key (32 bytes), signature (64 bytes), certificate (X.509, DER)` in base64url.
"""

import base64
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from cryptography.hazmat.primitives.serialization import Encoding

from teleop.messages.topics import Role
from teleop.security.credentials import Credentials
from teleop.security.identity import CERTIFICATE_ROLES, Identity, identify_holder
from teleop.security.key_files import UNREADABLE_ERRORS, CertificateError
from teleop.security.presence import Token
from teleop.security.revocation import RevocationList

KEY_BYTES, _SIGNATURE_BYTES = 32, 64
_PROOF_CERTIFICATE_OFFSET = KEY_BYTES + _SIGNATURE_BYTES
PROOF_MAX = 2000  # characters; ours have about 550


class Peer(NamedTuple):
    """A process whose token was believed."""

    role: Role
    nonce: int
    identity: Identity
    public: bytes  # its X25519 key
    certificate: x509.Certificate | None = None


class SignatureError(CertificateError):
    """A token with a genuine certificate that its sender does not hold the key of."""


class PairKeys(NamedTuple):
    """Keys of a pair of processes."""

    sending: bytes  # for our messages
    receiving: bytes  # for the peer's


class Handshake:
    """Makes the proofs of a process, and checks those of others."""

    def __init__(self, credentials: Credentials, session: str, nonce: int) -> None:
        self._credentials, self._session, self._nonce = credentials, session, nonce
        self._private = X25519PrivateKey.generate()
        self._public = self._private.public_key().public_bytes_raw()
        self._certificate = credentials.certificate.public_bytes(Encoding.DER)
        self._revoked = RevocationList(
            credentials.folder, credentials.authority, credentials.revoked, credentials.lasting
        )

    def prove(self, token: Token) -> Token:
        """Return our token with its proof, in the group of our certificate."""
        token = replace(token, limit=self._credentials.identity.limit)
        data = _build_signed_data(token, self._session, self._public + self._certificate)
        signature = self._credentials.key.sign(data)
        raw = self._public + signature + self._certificate
        return replace(token, proof=_encode_proof(raw))

    def check(self, token: Token) -> Peer:
        """Return whose token it is; `CertificateError` if it is not to be believed.

        `SignatureError` if only the signature is wrong. Takes 0.3 ms with a new certificate.
        """
        name = token.role.name.lower()
        if not token.proof:
            raise CertificateError(f"a {name} without a certificate")
        if len(token.proof) > PROOF_MAX:
            raise CertificateError(f"a {name} with a certificate that is too long")
        try:
            raw = base64.urlsafe_b64decode(token.proof + "=" * (-len(token.proof) % 4))
            if _encode_proof(raw) != token.proof:  # so that a process has one proof only
                raise ValueError
            certificate = x509.load_der_x509_certificate(raw[_PROOF_CERTIFICATE_OFFSET:])
        except UNREADABLE_ERRORS as error:
            raise CertificateError(f"a {name} with a certificate that cannot be read") from error
        identity = self._identify(certificate)
        if (identity.role, identity.limit) != (CERTIFICATE_ROLES[token.role], token.limit):
            raise CertificateError(f"a {name} with the certificate {identity.common_name}")
        if not identity.may_join(self._session):
            raise CertificateError(
                f"a {name} of session {identity.session!r}: the certificate is "
                f"{identity.common_name}"
            )
        public, signature = raw[:KEY_BYTES], raw[KEY_BYTES:_PROOF_CERTIFICATE_OFFSET]
        signed = _build_signed_data(token, self._session, public + raw[_PROOF_CERTIFICATE_OFFSET:])
        if not _is_valid_signature(certificate, signature, signed):
            raise SignatureError(
                f"a {name} that does not hold the key of its certificate {identity.common_name}"
            )
        return Peer(token.role, token.nonce, identity, public, certificate)

    @property
    def fault(self) -> str:
        """Why our own certificate is not believed any more; empty if it is."""
        return self._find_fault(self._credentials.certificate)

    def find_fault(self, peer: Peer) -> str:
        """Return why the certificate of a peer is not believed any more; empty if it is."""
        return "" if peer.certificate is None else self._find_fault(peer.certificate)

    def read_revoked(self, complain: Callable[[str], None]) -> bool:
        """Read the list of revoked certificates again if it has changed; return whether it grew."""
        return self._revoked.update(complain)

    def _identify(self, certificate: x509.Certificate) -> Identity:
        return identify_holder(certificate, self._credentials.authority, self._revoked.serials)

    def _find_fault(self, certificate: x509.Certificate) -> str:
        try:
            self._identify(certificate)
        except CertificateError as error:
            return str(error)
        return ""

    def derive_pair_keys(self, peer: Peer) -> PairKeys:
        """Return the keys shared with `peer` and nobody else; `CertificateError` if its is bad."""
        try:
            shared = self._private.exchange(X25519PublicKey.from_public_bytes(peer.public))
        except ValueError as error:
            raise CertificateError(f"a {peer.role.name.lower()} with an unusable key") from error
        return PairKeys(
            _derive_key(shared, self._session, self._nonce, peer.nonce),
            _derive_key(shared, self._session, peer.nonce, self._nonce),
        )


def _encode_proof(raw: bytes) -> str:
    """Return a proof as it stands in a token."""
    return base64.urlsafe_b64encode(raw).decode().rstrip("=")


def _build_signed_data(token: Token, session: str, shown: bytes) -> bytes:
    """Return what the signature covers; `shown` is the X25519 key and the certificate."""
    unsigned = replace(token, relayed=False, proof="").to_key(session)
    return b"teleop hello 1\0" + unsigned.encode() + b"\0" + shown


def _is_valid_signature(certificate: x509.Certificate, signature: bytes, data: bytes) -> bool:
    key = certificate.public_key()
    try:
        if isinstance(key, Ed25519PublicKey):
            key.verify(signature, data)
            return True
    except InvalidSignature:
        pass
    return False


def _derive_key(shared: bytes, session: str, sender: int, receiver: int) -> bytes:
    info = f"teleop message 1 {session} {sender:016x} {receiver:016x}".encode()
    return HKDF(hashes.SHA256(), KEY_BYTES, None, info).derive(shared)
