"""The network link: the only package that uses Zenoh.

Keys are `teleop/<session>/<topic>`; presence tokens are below `teleop/<session>/@`.
"""

from teleop.link.config import LinkConfig
from teleop.link.link import Link
from teleop.link.listener import Listener, ReceivedMessage
from teleop.link.reception import NEVER_NS, REJECTION_COUNTERS, LatestMessage, MessageCounts

__all__ = [
    "NEVER_NS",
    "REJECTION_COUNTERS",
    "LatestMessage",
    "Link",
    "LinkConfig",
    "Listener",
    "MessageCounts",
    "ReceivedMessage",
]
