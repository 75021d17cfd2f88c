"""Presence tokens of a session, and conflicts between processes.

Every process but listeners (recorders, viewers) announces itself by a liveliness token, which
vanishes with its process or connection:

    teleop/<session>/@/<group>/<layout>/<nonce>/<stage>[/<proof>]

The group is the role, and of a supervisor with some rights only also those, as in the common name
of its certificate: `remote-stop`. Zenoh's access control compares the two, so tokens of one group
cannot use up what another group may cost. The proof (`Handshake`) shows who it is; only an insecure
session has none. A listener declares no token, since the sides would have to keep it; it shows one
in its challenges (`teleop.link.admission`).

A session has one master and one slave. A new process first *claims* its role, waits for other
tokens, and then *holds* it. A claim yields to a holder; of two equals the older nonce stays. A
nonce begins with the start time of its process, but a holder never yields to a claim, so a wrong
clock cannot displace it.

Two masters are not connected to each other, only to the slave. The slave therefore repeats the
tokens of masters, below `relay`. Behind a router all see all tokens, and nothing is repeated.
"""

import base64
import re
import secrets
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import NamedTuple

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from cryptography.hazmat.primitives.serialization import Encoding

from teleop.errors import UsageError
from teleop.messages.topics import Role
from teleop.runtime.clock import now_ns
from teleop.security import CertificateError, Identity
from teleop.security.authority import REVOKED, UNREADABLE_ERRORS, load_revoked
from teleop.security.credentials import Credentials, identify_holder
from teleop.security.identity import CERTIFICATE_ROLES, RIGHT_SUFFIXES, CertificateRole

EXCLUSIVE_ROLES = (Role.MASTER, Role.SLAVE)
LISTENER_ROLES = (Role.RECORDER, Role.VIEWER)
_CERTIFICATE_OFFSET = 128  # character of a proof, behind the X25519 key and the signature
_NUMBERS = re.compile(r"[0-9a-f]{8}/[0-9a-f]{16}")  # layout and nonce; `int` takes more: -f, 1_2
_RANDOM_BITS = 12  # of 64; the rest is the start stamp, good for 4 us and until the year 2554


class RoleStage(IntEnum):
    """Whether a process claims or holds its role."""

    CLAIM = 0
    HELD = 1


def create_nonce() -> int:
    """Return a unique number that grows with time."""
    return (now_ns() >> _RANDOM_BITS << _RANDOM_BITS) | secrets.randbits(_RANDOM_BITS)


@dataclass(frozen=True, slots=True)
class Token:
    """A presence token."""

    role: Role
    layout: int
    nonce: int
    stage: RoleStage
    relayed: bool = False
    proof: str = ""
    # rights of a supervisor that has some only (`teleop.security.identity.RIGHT_SUFFIXES`)
    limit: str = ""

    @property
    def group(self) -> str:
        """Whose tokens share the bounds of what they may cost."""
        return f"{'relay/' if self.relayed else ''}{self.role.name.lower()}{self.limit}"

    @property
    def certificate(self) -> str:
        """The certificate in the proof, not read."""
        return self.proof[_CERTIFICATE_OFFSET:]

    def key(self, session: str) -> str:
        """Return the key of this token."""
        stage = self.stage.name.lower()
        proof = f"/{self.proof}" if self.proof else ""
        ends = f"{self.layout:08x}/{self.nonce:016x}/{stage}{proof}"
        return f"{build_token_root(session)}/{self.group}/{ends}"

    @classmethod
    def from_key(cls, key: str) -> "Token | None":
        """Return the token of a key; None if it is not one of this project.

        Two keys never have the same token: what is not written as `key` does it is none.
        """
        head, _, tail = key.partition("/@/")
        chunks = tail.split("/")
        relayed = chunks[0] == "relay"
        try:
            group, layout, nonce, stage, *proof = chunks[relayed:]
            if len(proof) > 1 or not _NUMBERS.fullmatch(f"{layout}/{nonce}"):
                return None
            name, dash, rights = group.partition("-")
            role, limit = Role[name.upper()], dash + rights
            if limit not in _list_right_suffixes(role):
                return None
            token = cls(
                role,
                int(layout, 16),
                int(nonce, 16),
                RoleStage[stage.upper()],
                relayed,
                proof[0] if proof else "",
                limit,
            )
        except (ValueError, KeyError):
            return None
        return token if token.key(head.removeprefix("teleop/")) == key else None


def list_groups(role: Role) -> list[str]:
    """Return the groups of a role's tokens."""
    return [role.name.lower() + limit for limit in _list_right_suffixes(role)]


def list_watched_groups(role: Role) -> list[str]:
    """Return the groups of the announced tokens that a process of `role` looks at."""
    roles = (
        [r for r in Role if r not in LISTENER_ROLES] if role in EXCLUSIVE_ROLES else EXCLUSIVE_ROLES
    )
    groups = [group for other in roles for group in list_groups(other)]
    return [*groups, "relay/master"] if role is Role.MASTER else groups


def may_stop(group: str) -> bool:
    """Return whether processes of a group may stop a session."""
    listens = group in [role.name.lower() for role in LISTENER_ROLES]
    return group.endswith("-stop") or not (listens or "-" in group)


def _list_right_suffixes(role: Role) -> tuple[str, ...]:
    return RIGHT_SUFFIXES if CERTIFICATE_ROLES[role] is CertificateRole.SUPERVISOR else ("",)


def build_token_root(session: str) -> str:
    """Return the key below which a session's tokens are; `**` from above does not match an `@`."""
    return f"teleop/{session}/@"


def find_conflict(me: Token, others: Iterable[Token]) -> str | None:
    """Return why `me` must leave the session, or None.

    A listener (recorder, viewer, launcher) never conflicts.
    """
    for other in others:
        if other.nonce == me.nonce or other.role not in EXCLUSIVE_ROLES:
            continue
        name = other.role.name.lower()
        if me.role in EXCLUSIVE_ROLES and (me.stage, -me.nonce) > (other.stage, -other.nonce):
            continue
        if other.layout != me.layout:
            return (
                f"has a {name} of message layout {other.layout:08x}, ours is {me.layout:08x}; "
                "install the same version on both machines"
            )
        if other.role == me.role:
            return f"has a {name} already; stop that one first, or choose another session name"
    return None


# --- the proof of a token, and the keys that follow from it
# A token ends with a *proof*: the certificate of its process, an X25519 public key drawn at its
# start, and a signature by the certificate's key over both and everything else in the token. So a
# token cannot be made, or changed, without the private key of a certificate. From the two public
# keys each pair of processes derives its keys, one for each direction (Diffie and Hellman, RFC
# 7748; HKDF, RFC 5869). They are bound to both nonces, so they are new whenever one of the two
# processes is: no message of an earlier run passes.
#
# The proof is `key (32 bytes), signature (64 bytes), certificate (X.509, DER)` in base64url.


# --- the list of revoked certificates of a running process, which follows the file


class RevocationList:
    """What is revoked, by the file in the folder of keys; read again when that changes.

    A certificate that was revoked once stays so in this process. A file that is missing, damaged or
    not signed by the authority changes nothing and is complained about, once.

    `credentials` are of this process, with the list as it was at the start.
    """

    def __init__(self, credentials: Credentials) -> None:
        self.serials = credentials.revoked
        self._credentials = credentials
        self._seen = self._state()

    def update(self, complain: Callable[[str], None]) -> bool:
        """Read the file if it has changed; return whether more certificates are revoked."""
        state, folder = self._state(), self._credentials.folder
        if state == self._seen or folder is None:
            return False
        self._seen = state
        try:
            revoked = load_revoked(folder, self._credentials.authority)
        except UsageError as error:
            if self._credentials.lasting:  # a local authority is replaced when it has expired
                complain(f"a list of revoked certificates: {error}; the earlier one stays in force")
            return False
        grown = not revoked <= self.serials
        self.serials |= revoked
        return grown

    def _state(self) -> tuple[int, ...]:
        """Return what changes with the file."""
        folder = self._credentials.folder
        if folder is None:
            return ()
        try:
            status = (folder / REVOKED).stat()
        except OSError:
            return (0,)
        return status.st_mtime_ns, status.st_size, status.st_ino


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
        self._revoked = RevocationList(credentials)

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
    unsigned = replace(token, relayed=False, proof="").key(session)
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
