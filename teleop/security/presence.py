"""Presence tokens of a session, and conflicts between processes.

Every process but listeners (recorders, viewers) announces itself by a liveliness token, which
vanishes with its process or connection:

    teleop/<session>/@/<group>/<layout>/<nonce>/<stage>[/<proof>]

The group is the role, and of a supervisor with some rights only also those, as in the common name
of its certificate: `remote-stop`. Zenoh's access control compares the two, so tokens of one group
cannot use up what another group may cost. The proof (`teleop.security.handshake`) shows who it is;
only an insecure session has none. A listener declares no token, since the sides would have to keep
it; it shows one in its challenges (`teleop.link.admission`).

A session has one master and one slave. A new process first *claims* its role, waits for other
tokens, and then *holds* it. A claim yields to a holder; of two equals the older nonce stays. A
nonce begins with the start time of its process, but a holder never yields to a claim, so a wrong
clock cannot displace it.

Two masters are not connected to each other, only to the slave. The slave therefore repeats the
tokens of masters, below `relay`. Behind a router all see all tokens, and nothing is repeated.
"""

import re
import secrets
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum

from teleop.messages.topics import Role
from teleop.runtime.clock import now_ns
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

    def to_key(self, session: str) -> str:
        """Return the key of this token."""
        stage = self.stage.name.lower()
        proof = f"/{self.proof}" if self.proof else ""
        ends = f"{self.layout:08x}/{self.nonce:016x}/{stage}{proof}"
        return f"{build_token_root(session)}/{self.group}/{ends}"

    @classmethod
    def from_key(cls, key: str) -> "Token | None":
        """Return the token of a key; None if it is not one of this project.

        Two keys never have the same token: what is not written as `to_key` does it is none.
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
        return token if token.to_key(head.removeprefix("teleop/")) == key else None


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
