"""Presence tokens of a session, and conflicts between processes.

Every process announces itself by a liveliness token, which vanishes with its process or connection:

    teleop/<session>/@/<role>/<layout>/<nonce>/<stage>[/<proof>]

The proof (`teleop.link.handshake`) shows who it is; only an insecure session has none.

A session has one master and one slave. A new process first *claims* its role, waits for other
tokens, and then *holds* it. A claim yields to a holder; of two equals the older nonce stays. A
nonce begins with the start time of its process, but a holder never yields to a claim, so a wrong
clock cannot displace it.

Two masters are not connected to each other, only to the slave. The slave therefore repeats the
tokens of masters, below `relay`. Behind a router all see all tokens, and nothing is repeated.
"""

import secrets
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum

from teleop.clock import now_ns
from teleop.topics import Role

EXCLUSIVE = (Role.MASTER, Role.SLAVE)
_RANDOM_BITS = 12  # of 64; the rest is the start stamp, good for 4 us and until the year 2554


class Stage(IntEnum):
    """Whether a process claims or holds its role."""

    CLAIM = 0
    HELD = 1


def new_nonce() -> int:
    """Return a unique number that grows with time."""
    return (now_ns() >> _RANDOM_BITS << _RANDOM_BITS) | secrets.randbits(_RANDOM_BITS)


@dataclass(frozen=True, slots=True)
class Token:
    """A presence token."""

    role: Role
    layout: int
    nonce: int
    stage: Stage
    relayed: bool = False
    proof: str = ""

    def key(self, session: str) -> str:
        """Return the key of this token."""
        relay = "relay/" if self.relayed else ""
        name, stage = self.role.name.lower(), self.stage.name.lower()
        proof = f"/{self.proof}" if self.proof else ""
        return f"{root(session)}/{relay}{name}/{self.layout:08x}/{self.nonce:016x}/{stage}{proof}"

    @classmethod
    def from_key(cls, key: str) -> "Token | None":
        """Return the token of a key; None if it is not one of this project."""
        chunks = key.split("/@/", 1)[-1].split("/")
        relayed = chunks[0] == "relay"
        try:
            name, layout, nonce, stage, *proof = chunks[relayed:]
            if len(proof) > 1 or not (len(layout) == 8 and len(nonce) == 16):
                return None
            return cls(
                Role[name.upper()],
                int(layout, 16),
                int(nonce, 16),
                Stage[stage.upper()],
                relayed,
                *proof,
            )
        except (ValueError, KeyError):
            return None


def root(session: str) -> str:
    """Return the key below which a session's tokens are; `**` from above does not match an `@`."""
    return f"teleop/{session}/@"


def conflict(me: Token, others: Iterable[Token]) -> str | None:
    """Return why `me` must leave the session, or None.

    A listener (recorder, viewer, launcher) never conflicts.
    """
    for other in others:
        if other.nonce == me.nonce or other.role not in EXCLUSIVE:
            continue
        name = other.role.name.lower()
        if me.role in EXCLUSIVE and (me.stage, -me.nonce) > (other.stage, -other.nonce):
            continue
        if other.layout != me.layout:
            return (
                f"has a {name} of message layout {other.layout:08x}, ours is {me.layout:08x}; "
                "install the same version on both machines"
            )
        if other.role == me.role:
            return f"has a {name} already; stop that one first, or choose another session name"
    return None
