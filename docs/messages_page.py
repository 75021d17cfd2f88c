"""The page of topics and messages, from the declarations.

`python -m docs.messages_page` prints it, and `make docs` puts it into the site.
"""

import inspect
from collections.abc import Mapping
from enum import IntEnum
from typing import Any

from teleop.config.comments import read_field_comments
from teleop.messages.messages import (
    ENCAPSULATION,
    LAYOUT,
    MESSAGES,
    PHASE_NAMES,
    STAGE_NAMES,
    STATUS_NAMES,
    STOP_ACTIONS,
    TEXT_BYTES,
    EmergencyStop,
    Head,
    Message,
)
from teleop.messages.topics import TOPICS, Role, Topic
from teleop.session.state_machine import Reason, State

_HEAD_FIELDS = 5

_INTRODUCTION = """\
# Topics and messages

Generated from `teleop/messages/messages.py` and `teleop/messages/topics.py` by
`python -m docs.messages_page`.

| | |
|---|---|
| key on the network (Zenoh) | `teleop/<session>/<topic>` |
| key of copies for viewers | `teleop/<session>/<topic>/sampled`: the same bytes without tags, the \
first message of each period of the rate below "sampled" |
| channel in a [recording](../how-to/record-and-view.md) | `/<topic>` |
| bytes | CDR, little-endian: `00 01 00 00`, then each field at its natural alignment, counted \
from byte 4; the tables below give each field's first byte |
| arrays | of fixed length; entries beyond the number in use mean nothing |
| units | SI |
| live topics | best effort: what cannot be sent at once is dropped; readers use the newest value \
and its age |
| reliable topics | ordered, and repeated by the transport; a sender never waits, so what a \
stalled listener misses is a gap in the sequence |
"""

_HEAD_TEXT = """\
## The head

Every message begins with these fields.

| byte | field | type | |
|---|---|---|---|
{fields}
**Encapsulation header.** Bytes 0 to 3 are `{encapsulation}` in every message: CDR, little-endian.

**Checksum.** CRC-32 as `zlib.crc32` computes it (IEEE 802.3: polynomial `04c11db7`, reflected
`edb88320`, initial value and final exclusive or `ffffffff`), seeded with the CRC-32 of the
message's name in ASCII ([seeds](#seeds-and-sizes)). It covers bytes 8 to the end, that is,
everything after the checksum itself. So it equals the CRC-32 of the name followed by these bytes:

```python
def seal(name: str, message: bytearray) -> None:  # seal("Command", ...)
    checksum = zlib.crc32(message[8:], zlib.crc32(name.encode()))
    message[4:8] = checksum.to_bytes(4, "little")
```

**Layout.** CRC-32 (seed 0) of the text of all declarations: for each message in the order of this
page its name, then one `type name` for each field, the head's included, each on a line of its own.
Array types have their length: `float64[8] position`. In this version `{layout:08x}`; a message of
another layout is dropped.

## Tokens and tags

**Presence.** Each process but recorders and viewers declares a liveliness token, which
vanishes with it:

    teleop/<session>/@/<group>/<layout>/<sender>/<stage>/<proof>

`group` is the role, and of a supervisor with some rights only also those, as in the common name of
its certificate: `remote-stop` of `supervisor-stop.bench`. `layout` and `sender` have 8 and 16
hexadecimal digits; `stage` is `claim` while it looks whether its role is taken, then `held`. The
proof is, in base64url without padding: an X25519 public key drawn at the start (32 bytes), an
Ed25519 signature (64 bytes), and the process's certificate (X.509, DER). The signature covers,
joined by a zero byte, `teleop hello 1`, the token's key up to the stage, and public key and
certificate in succession. A token without a valid proof of a certificate of its group and session
is ignored.

**Challenges.** A token can be played back, so a process must answer when it is asked, every two
seconds or so, for its token to count. A challenge is a query on

    teleop/<session>/@/prove/<group of who asks>/<sender of who is asked>

with the payload: 16 random bytes; the sender in question (u64, little-endian), which is who is
asked or, of a slave, a master that it has relayed; and the key of a token of who asks. The answer
is the BLAKE2b of 32 bytes of the first 24 bytes of the payload, with the pair key from who is asked
to who asks, and `teleop present` as `person`. Sides ask each other and the supervisors, all others
the sides; recorders and viewers are asked by nobody. A challenge also announces who asks: its token
may have been lost in a flood. So it is repeated, each time later, until it is answered. Recorders
and viewers declare no token and show one in their challenges only, as `held`.

**Pair keys.** Sender and addressee derive the key of their direction from the shared secret of
X25519 by HKDF-SHA256 without salt, 32 bytes, with the info `teleop message 1 <session> <sender>
<addressee>` (nonces as above).

**Tags.** A message that moves something carries, as the attachment of its Zenoh sample, for each
addressee its nonce (u64, little-endian) and the tag: BLAKE2b of 16 bytes of the whole message, with
the pair key as key and the topic's name as `person`. The addressee ignores a message without its
tag; the bytes of the message, and so recordings, are the same with and without. Tagged are:

| topic | for |
|---|---|
{tagged}

An insecure session has neither proofs nor tags.

## Write a message

1. Take as many zero bytes as the message has; padding stays zero.
2. Put the encapsulation header into bytes 0 to 3.
3. Put each field at its byte, little-endian: those of the head but the checksum, then those of the
   message. An element of an array follows the one before without a gap; text is UTF-8, one byte an
   element, filled up with zeros.
4. Put the checksum into bytes 4 to 7.
5. Publish the bytes at the key `teleop/<session>/<topic>`, with the [tags](#tokens-and-tags) of its
   addressees as the attachment.

| type | bytes | `struct` of Python | |
|---|---|---|---|
{types}

### Seeds and sizes

| message | bytes | seed of the checksum |
|---|---|---|
{seeds}

### An example

{example_name} with these values (hexadecimal where in code type), all others zero:

| byte | field | value |
|---|---|---|
{example_values}

```text
{example_bytes}
```

To stop the session `demo`, publish this at `teleop/demo/stop`, with a sender, a stamp and tags of
your own; from another sender, with another stamp, it has another checksum.

## A client of your own

| to | a process must |
|---|---|
| connect | open a Zenoh session in peer mode without scouting, to both endpoints of `link`, with \
mutual TLS and a certificate of `teleop keys issue` ([configuration](configuration.md#the-link)) |
| listen | subscribe to the topic's key, or to that of its copies |
| stop a session, reset a stop, change a setting | be announced by a token, as `remote`, have a \
supervisor's certificate with the right, and tag its messages |
| publish any topic | draw a new `sender` at each start, and count its messages from 1 |
| be seen by viewers | publish copies of the topics that have a rate "sampled" |

Topics from the master or the slave are accepted from the announced process of that role only. A
session has one of each (`teleop/security/presence.py`).
"""

_TYPES = (  # of fields: ROS 2 name, meaning
    ("uint8", "unsigned"),
    ("uint32", "unsigned"),
    ("uint64", "unsigned"),
    ("int64", "two's complement"),
    ("float64", "IEEE 754"),
)

_EXAMPLE = EmergencyStop(
    role=int(Role.REMOTE), text=(*b"a switch by the door", *(0,) * (TEXT_BYTES - 20))
)
_EXAMPLE_HEAD = Head(0x0123456789ABCDEF, 1, 1_700_000_000_000_000_000)

_HEAD_COMMENTS = {"checksum": "see below", "layout": "see below", **read_field_comments(Head)}

_NUMBERS = """\
## Numbers

| field | values, from 0 |
|---|---|
| `role` | {roles} |
| `state` | {states} ([safety](../explanation/safety.md#session-states)) |
| `phase` | {phases} |
| `status`, bits from the lowest | {statuses} |
| `action` of `stop` | {actions} |
| stages of `latency` | {stages} |

| `reason` | |
|---|---|
{reasons}
"""


def format_page() -> str:
    """Return the whole page as Markdown."""
    lines = [_INTRODUCTION, "## Topics\n", "| topic | message | from | rate | sampled | kind |"]
    lines.append("|---|---|---|---|---|---|")
    lines += map(_format_topic_row, TOPICS)
    head = "\n".join(_format_field_rows(MESSAGES[0], _HEAD_COMMENTS, slice(_HEAD_FIELDS)))
    tagged = "\n".join(
        f"| `{topic.name}` | {', '.join(role.name.lower() for role in topic.addressees)} |"
        for topic in TOPICS
        if topic.addressees
    )
    text = _HEAD_TEXT.format(
        fields=head + "\n", layout=LAYOUT, tagged=tagged, **_build_instructions()
    )
    lines += ["", text]
    lines += map(_format_section, MESSAGES)
    lines.append(_format_numbers())
    return "\n".join(lines).rstrip() + "\n"


def _format_topic_row(topic: Topic[Any]) -> str:
    sender = ", ".join(role.name.lower() for role in topic.publishers)
    rate = f"{topic.rate_hz:g} Hz" if topic.rate_hz else "on events"
    sampled = f"{topic.sampled_hz:g} Hz" if topic.sampled_hz else ""
    kind = "live" if topic.live else "reliable"
    name = topic.message.__name__
    return (
        f"| `{topic.name}` | [{name}](#{name.lower()}) | {sender} | {rate} | {sampled} | {kind} |"
    )


def _build_instructions() -> dict[str, str]:
    """Return what the page says on writing a message: types, seeds and an example."""
    wires = {wire.ros: wire for cls in MESSAGES for wire in cls.schema.wires.values()}
    types = [f"| {t} | {wires[t].size} | `<{wires[t].code}` | {text} |" for t, text in _TYPES]
    seeds = [f"| {c.__name__} | {c.schema.size} | `{c.schema.seed:08x}` |" for c in MESSAGES]
    return {
        "encapsulation": ENCAPSULATION.hex(" "),
        "types": "\n".join(types),
        "seeds": "\n".join(seeds),
        "example_name": f"`{type(_EXAMPLE).__name__}`",
        "example_values": "\n".join(_format_example_values()),
        "example_bytes": format_hex_dump(_EXAMPLE.pack(*_EXAMPLE_HEAD)),
    }


def _format_example_values() -> list[str]:
    """Return a table's rows of the example's fields that are not zero."""
    offsets: Mapping[str, Any] = _EXAMPLE.schema.dtype.fields or {}
    values = {"layout": f"`{LAYOUT:08x}`", "sender": f"`{_EXAMPLE_HEAD.sender:016x}`"}
    values |= {name: str(getattr(_EXAMPLE_HEAD, name)) for name in ("sequence", "stamp_ns")}
    for name, wire in list(_EXAMPLE.schema.wires.items())[_HEAD_FIELDS:]:
        value = getattr(_EXAMPLE, name)
        if wire.count > 1:
            values[name] = f'"{bytes(value).rstrip(bytes(1)).decode()}"'
        elif value:
            values[name] = str(value)
    return [f"| {offsets[name][1]} | `{name}` | {value} |" for name, value in values.items()]


def format_hex_dump(data: bytes) -> str:
    """Return bytes as lines of 16, each with the number of its first byte."""
    starts = range(0, len(data), 16)
    return "\n".join(f"{at:04x}  {data[at : at + 16].hex(' ')}" for at in starts)


def _format_section(cls: type[Message]) -> str:
    comments = read_field_comments(cls)
    lines = [f"## {cls.__name__}\n", f"{inspect.getdoc(cls)}\n", f"{cls.schema.size} bytes.\n"]
    lines += ["| byte | field | type | |", "|---|---|---|---|"]
    lines += _format_field_rows(cls, comments, slice(_HEAD_FIELDS, None))
    return "\n".join(lines) + "\n"


def _format_field_rows(cls: type[Message], comments: dict[str, str], which: slice) -> list[str]:
    """Return a table's rows of some fields of a message."""
    offsets: Mapping[str, Any] = cls.schema.dtype.fields or {}
    rows = []
    for name, wire in list(cls.schema.wires.items())[which]:
        count = f"[{wire.count}]" if wire.count > 1 else ""
        comment = comments.get(name, "")
        rows.append(f"| {offsets[name][1]} | `{name}` | {wire.ros}{count} | {comment} |")
    return rows


def _format_numbers() -> str:
    """Return the meaning of the numbers that stand for names."""
    return _NUMBERS.format(
        roles=_format_names(Role),
        states=_format_names(State),
        phases=", ".join(PHASE_NAMES),
        statuses=", ".join(STATUS_NAMES),
        actions=", ".join(STOP_ACTIONS),
        stages=", ".join(STAGE_NAMES),
        reasons="\n".join(f"| {reason.value} | {reason.text} |" for reason in Reason),
    )


def _format_names(numbers: type[IntEnum]) -> str:
    return ", ".join(number.name.lower() for number in numbers)


if __name__ == "__main__":
    print(format_page(), end="")
