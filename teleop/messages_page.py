"""Generate the docs page of topics and messages from the declarations.

python -m teleop.messages_page > docs/messages.md
"""

import inspect
import re
from typing import Any

from teleop.messages import LAYOUT, MESSAGES, Message
from teleop.topics import TOPICS, Topic

_HEAD_FIELDS = 5
_COMMENT = re.compile(r"^\s+(?P<name>\w+): .*?# (?P<comment>.*)$", re.MULTILINE)

_INTRODUCTION = """\
# Topics and messages

Made from `teleop/messages.py` and `teleop/topics.py` by `python -m teleop.messages_page`, not by
hand.

A topic's key on the network is `teleop/<session>/<topic>`, its channel in a recording `/<topic>`.
The bytes are CDR, little-endian: `00 01 00 00`, then each field at its natural alignment. All
arrays have a fixed length; entries beyond the number in use are undefined. Units are SI.

A *live* topic is best effort: what cannot be sent at once is dropped, and readers use the newest
value and its age. A *reliable* one is ordered and retransmitted by the transport, but the sender
never waits; messages missed by a stalled listener show as a gap in the sequence.
"""

_HEAD_TEXT = """\
## The head

Every message begins with these fields, filled in and checked by the link.

| field | type | |
|---|---|---|
| `checksum` | uint32 | CRC-32 of everything behind it |
| `layout` | uint32 | CRC-32 of all declarations; in this version `{layout:08x}` |
| `sender` | uint64 | drawn when the sending process started |
| `sequence` | uint64 | counts the messages of this topic from this sender, from 1 |
| `stamp_ns` | int64 | when it was sent [ns since the Unix epoch, on the sender's clock] |
"""


def page() -> str:
    """Return the whole page as Markdown."""
    lines = [_INTRODUCTION, "## Topics\n", "| topic | message | from | rate | kind |"]
    lines.append("|---|---|---|---|---|")
    lines += map(_topic_row, TOPICS)
    lines += ["", _HEAD_TEXT.format(layout=LAYOUT)]
    for cls in MESSAGES:
        lines.append(_section(cls))
    return "\n".join(lines).rstrip() + "\n"


def _topic_row(topic: Topic[Any]) -> str:
    sender = "any" if topic.publisher is None else topic.publisher.name.lower()
    rate = f"{topic.rate_hz:g} Hz" if topic.rate_hz else "on events"
    kind = "live" if topic.live else "reliable"
    name = topic.message.__name__
    return f"| `{topic.name}` | [{name}](#{name.lower()}) | {sender} | {rate} | {kind} |"


def _section(cls: type[Message]) -> str:
    comments = {m["name"]: m["comment"] for m in _COMMENT.finditer(inspect.getsource(cls))}
    lines = [f"## {cls.__name__}\n", f"{inspect.getdoc(cls)}\n"]
    lines.append(f"{cls.schema.size} bytes.\n")
    lines += ["| field | type | |", "|---|---|---|"]
    for name, wire in list(cls.schema.wires.items())[_HEAD_FIELDS:]:
        count = f"[{wire.count}]" if wire.count > 1 else ""
        lines.append(f"| `{name}` | {wire.ros}{count} | {comments.get(name, '')} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(page(), end="")
