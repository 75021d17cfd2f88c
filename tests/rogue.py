"""A rogue peer: raw Zenoh and `struct`, and what can be learnt by listening."""

import itertools
import json
import struct
import time
import zlib
from typing import Any

import zenoh

HEAD = struct.Struct("<IIQQq")  # checksum, layout, sender, sequence, stamp
STATE_AT = 36  # byte of `state` in commands and states
POSITION_AT = 52  # byte of `position` in commands
STOP, RESET, WATCH, LEAVE = range(4)  # actions of an emergency stop
ENGAGED = 2


class Rogue:
    """A peer that sends whatever it likes.

    Parameters
    ----------
    endpoints : list of str
        Addresses of its victims, `HOST:PORT`.
    session : str
        Their session.
    tls : dict, optional
        Certificates and key as Zenoh takes them; None: plain TCP.
    """

    def __init__(self, endpoints: list[str], session: str, tls: dict[str, str] | None) -> None:
        protocol = "tcp" if tls is None else "tls"
        settings: dict[str, Any] = {
            "mode": "peer",
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "connect/endpoints": [f"{protocol}/{endpoint}" for endpoint in endpoints],
            "listen/endpoints": [],
            "connect/timeout_ms": -1,
            "connect/exit_on_failure": False,
            "transport/link/protocols": [protocol],
        }
        if tls is not None:
            settings["transport/link/tls"] = {
                "enable_mtls": True, "verify_name_on_connect": False, **tls
            }  # fmt: skip
        config = zenoh.Config()
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))
        self.session = session
        self.heard: dict[str, list[tuple[bytes, bytes]]] = {}  # by topic: message and tags
        self.tokens: list[str] = []  # keys of the tokens that it saw
        self._kept: list[Any] = []
        self._sequence = itertools.count(1)
        self._zenoh: Any = zenoh.open(config)
        self._zenoh.liveliness().declare_subscriber(
            f"teleop/{session}/@/**", self._on_token, history=True
        )

    def __enter__(self) -> "Rogue":
        return self

    def __exit__(self, *_: object) -> None:
        self._zenoh.close()

    def connected(self, count: int = 1) -> bool:
        return len(self._zenoh.info.peers_zid()) >= count

    def listen(self, topic: str) -> None:
        heard = self.heard.setdefault(topic, [])

        def store(sample: Any) -> None:
            tags = sample.attachment
            heard.append((sample.payload.to_bytes(), b"" if tags is None else tags.to_bytes()))

        self._zenoh.declare_subscriber(f"teleop/{self.session}/{topic}", store)

    def announce(self, role: str, layout: int, nonce: int, stage: str = "held", proof: str = ""):
        key = f"teleop/{self.session}/@/{role}/{layout:08x}/{nonce:016x}/{stage}"
        self.announce_key(f"{key}/{proof}" if proof else key)

    def announce_key(self, key: str) -> None:
        self._kept.append(self._zenoh.liveliness().declare_token(key))

    def answer(self, role: str, nonce: int) -> None:
        """Declare that it answers challenges to a process."""
        key = f"teleop/{self.session}/@/prove/{role}/{nonce:016x}"
        self._kept.append(self._zenoh.declare_queryable(key, lambda _: None))

    def token_of(self, role: str) -> str:
        """The key of a token that it has seen."""
        return next(key for key in self.tokens if f"/@/{role}/" in key and "/held/" in key)

    def put(self, topic: str, data: bytes, tags: bytes | None = None) -> None:
        self._zenoh.put(f"teleop/{self.session}/{topic}", data, attachment=tags)

    def stop(self, layout: int, sender: int, action: int, side: int = 0, number: int = 0) -> None:
        """Call for a stop, or its reset."""
        body = struct.pack("<IIII", 5, action, side, number) + bytes(256)
        self.put("stop", sealed("EmergencyStop", layout, sender, next(self._sequence), body))

    def set(self, layout: int, sender: int, key: bytes, value: bytes) -> None:
        body = struct.pack("<I", 5) + key.ljust(256, b"\0") + value.ljust(256, b"\0")
        self.put("setting", sealed("Setting", layout, sender, next(self._sequence), body))

    def _on_token(self, sample: Any) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            self.tokens.append(str(sample.key_expr))


def sealed(name: str, layout: int, sender: int, sequence: int, body: bytes) -> bytes:
    """A message with its head and checksum, its tags excepted."""
    rest = HEAD.pack(0, layout, sender, sequence, time.time_ns())[4:] + body
    checksum = zlib.crc32(rest, zlib.crc32(name.encode()))
    return b"\x00\x01\x00\x00" + checksum.to_bytes(4, "little") + rest


def head(data: bytes) -> tuple[int, ...]:
    """Checksum, layout, sender, sequence and stamp of a message."""
    return HEAD.unpack_from(data, 4)


def forged(name: str, data: bytes, sequence: int, *changes: tuple[int, bytes]) -> bytes:
    """A message like `data`, newer, with other bytes at some places, and its checksum right."""
    body = bytearray(data)
    for place, new in changes:
        body[place : place + len(new)] = new
    _, layout, sender, _, _ = head(data)
    return sealed(name, layout, sender, sequence, bytes(body[4 + HEAD.size :]))
