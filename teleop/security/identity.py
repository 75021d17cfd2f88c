"""Whom a certificate stands for: a role in a session, with the rights of a supervisor.

The common name of a certificate says it, `<role>.<session>`, since that is what Zenoh's access
control compares: `master.bench`, `supervisor.bench` (all rights), `supervisor-stop.bench` (stops
only), `router.*` (the router of all sessions).
"""

import re
from datetime import UTC, datetime
from enum import StrEnum
from itertools import combinations
from typing import NamedTuple

from cryptography import x509

from teleop.messages.topics import Role
from teleop.security.key_files import (
    UNREADABLE_ERRORS,
    CertificateError,
    NotYetValidError,
    is_signed_by,
    read_common_name,
)
from teleop.security.revocation import refuse_revoked

ALL_SESSIONS = "*"  # of a router's certificate
RIGHTS = ("reset", "set", "stop")  # of a supervisor, in this order in its name
RIGHT_SUFFIXES = (
    "",
    *("".join(f"-{right}" for right in rights)
      for count in range(1, len(RIGHTS)) for rights in combinations(RIGHTS, count)),
)  # fmt: skip
"""What follows the role in the common name of a supervisor: nothing, or the only rights it has."""
_NAME = re.compile(r"(?P<role>[a-z]+)(?P<rights>(?:-[a-z]+)*)\.(?P<session>[a-z0-9_-]+|\*)")


class CertificateRole(StrEnum):
    """Role that a certificate is issued for."""

    MASTER = "master"
    SLAVE = "slave"
    SUPERVISOR = "supervisor"  # of `teleop run`, `teleop stop` and `teleop set`
    RECORDER = "recorder"
    VIEWER = "viewer"
    ROUTER = "router"  # of a router, and of the proxy of `teleop impair`


CERTIFICATE_ROLES: dict[Role, CertificateRole] = {
    Role.LAUNCHER: CertificateRole.SUPERVISOR,
    Role.MASTER: CertificateRole.MASTER,
    Role.SLAVE: CertificateRole.SLAVE,
    Role.RECORDER: CertificateRole.RECORDER,
    Role.VIEWER: CertificateRole.VIEWER,
    Role.REMOTE: CertificateRole.SUPERVISOR,
    Role.WATCH: CertificateRole.SUPERVISOR,
}
"""The certificate that a process of a role shows."""


class Identity(NamedTuple):
    """Holder of a certificate."""

    role: CertificateRole
    session: str  # `ALL_SESSIONS` for a router of all
    rights: tuple[str, ...] = ()  # of a supervisor, as in `RIGHTS`

    @property
    def limit(self) -> str:
        """What its common name says of its rights, one of `RIGHT_SUFFIXES`."""
        limited = self.role is CertificateRole.SUPERVISOR and self.rights != RIGHTS
        return "".join(f"-{right}" for right in self.rights) if limited else ""

    @property
    def common_name(self) -> str:
        """The common name of the certificate."""
        return f"{self.role}{self.limit}.{self.session}"

    @classmethod
    def parse(cls, common_name: str) -> "Identity":
        """Return the holder named by a common name; raises `ValueError`."""
        match = _NAME.fullmatch(common_name)
        if match is None:
            raise ValueError(f"{common_name!r} is not ROLE.SESSION")
        role = CertificateRole(match["role"])
        rights: tuple[str, ...] = ()
        if role is CertificateRole.SUPERVISOR:
            rights = tuple(match["rights"].split("-")[1:]) or RIGHTS
        identity = cls(role, match["session"], rights)
        if identity.common_name != common_name or not set(rights) <= set(RIGHTS):
            raise ValueError(f"{common_name!r} is not ROLE.SESSION")
        if identity.session == ALL_SESSIONS and role is not CertificateRole.ROUTER:
            raise ValueError(f"{common_name!r}: only a router is for all sessions")
        return identity

    def may_join(self, session: str) -> bool:
        """Return whether the holder belongs to a session."""
        return self.session in (session, ALL_SESSIONS)


def identify_holder(
    certificate: x509.Certificate, authority: x509.Certificate, revoked: frozenset[int]
) -> Identity:
    """Return whom a certificate stands for.

    Raises `CertificateError` if it is of another authority, expired, revoked, or names no role;
    `NotYetValidError` if it is not yet valid.
    """
    try:
        name = read_common_name(certificate)
        start, end = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    except UNREADABLE_ERRORS as error:
        raise CertificateError("a certificate that cannot be read") from error
    if not is_signed_by(certificate, authority):
        raise CertificateError(f"the certificate {name} is of another authority")
    now = datetime.now(UTC)
    if now > end:
        raise CertificateError(
            f"the certificate {name} expired on {end:%Y-%m-%d %H:%M} UTC; issue a new one with "
            f"`teleop keys issue`, or check the clock, by which it is {now:%Y-%m-%d %H:%M}"
        )
    if now < start:
        raise NotYetValidError(
            f"the certificate {name} is valid from {start:%Y-%m-%d %H:%M} UTC on; check the clock, "
            f"by which it is {now:%Y-%m-%d %H:%M}"
        )
    if now > authority.not_valid_after_utc:
        raise CertificateError(
            f"the authority of the certificate {name} expired on "
            f"{authority.not_valid_after_utc:%Y-%m-%d %H:%M} UTC; make a new one with "
            "`teleop keys init`"
        )
    refuse_revoked(certificate, revoked)
    try:
        return Identity.parse(name)
    except ValueError as error:
        raise CertificateError(f"the certificate {error}") from error


def list_supervisor_names(session: str, right: str) -> list[str]:
    """Return the common names of all supervisors of a session that have a right."""
    return [
        Identity(CertificateRole.SUPERVISOR, session, rights).common_name
        for count in range(1, len(RIGHTS) + 1)
        for rights in combinations(RIGHTS, count)
        if right in rights
    ]
