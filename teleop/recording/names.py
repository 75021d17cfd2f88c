"""Names in a recording, for writer and reader."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mcap.records import Channel  # not needed for the names alone

SESSION_METADATA = "recording"  # session, start, message layout, protection
VERSIONS_METADATA = "versions"  # of the writing software
GAPS_METADATA = "gaps"  # "<topic>/<sender>": lost messages; the last record of the name counts
DROPPED_METADATA = "dropped"  # "<topic>": came, but the recorder was too slow; the last one counts
END_METADATA = "end"  # how the recording ended: what is missing, largest lag, unfinished senders
CONFIG_ATTACHMENT = "config.yaml"
SCHEMA_PACKAGE = "tendon_teleop"


def to_channel_name(topic: str) -> str:
    """Return the MCAP name of a topic, which as in ROS begins with a slash."""
    return f"/{topic}"


def to_topic_name(channel: "Channel") -> str:
    """Return the topic's name in `teleop.messages.topics`."""
    return channel.topic.removeprefix("/")
