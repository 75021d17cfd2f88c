"""Who is in a session, and who must leave it again.

Every process announces itself by a token of this name, which vanishes with its process or its wire:

    teleop/<session>/@/<role>/<layout>/<nonce>/<stage>

A session has one master and one slave. A newcomer first *claims* its place, looks about for a
moment, and then *holds* it. A claim yields to a holder; of two equals the older nonce stays. A
nonce begins with the time its process started, but a running process never yields to one that only
claims, so a wrong clock cannot unseat it.

Two masters know nothing of each other, as each is connected to the slave only. The slave therefore
repeats the tokens of the masters it hears, below `relay`.
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
    """How sure a process is of its place."""

    CLAIM = 0
    HELD = 1


def new_nonce() -> int:
    """Return a number that no other process draws and that grows with time."""
    return (now_ns() >> _RANDOM_BITS << _RANDOM_BITS) | secrets.randbits(_RANDOM_BITS)


@dataclass(frozen=True, slots=True)
class Token:
    """One announcement."""

    role: Role
    layout: int
    nonce: int
    stage: Stage
    relayed: bool = False

    def key(self, session: str) -> str:
        """Return the key that announces this."""
        relay = "relay/" if self.relayed else ""
        name, stage = self.role.name.lower(), self.stage.name.lower()
        return f"{root(session)}/{relay}{name}/{self.layout:08x}/{self.nonce:016x}/{stage}"

    @classmethod
    def from_key(cls, key: str) -> "Token | None":
        """Return the announcement in a key; None if it is not one of ours."""
        chunks = key.split("/@/", 1)[-1].split("/")
        relayed = chunks[0] == "relay"
        try:
            name, layout, nonce, stage = chunks[relayed:]
            return cls(
                Role[name.upper()], int(layout, 16), int(nonce, 16), Stage[stage.upper()], relayed
            )
        except (ValueError, KeyError):
            return None


def root(session: str) -> str:
    """Return the key below which a session's tokens are; `**` from above does not match an `@`."""
    return f"teleop/{session}/@"


def conflict(me: Token, others: Iterable[Token]) -> str | None:
    """Return why `me` must leave the session, or None.

    A listener (recorder, viewer, launcher) takes nobody's place and is never a reason to leave.
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
