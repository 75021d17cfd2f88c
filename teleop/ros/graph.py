"""What `rmw_zenoh` writes on Zenoh: keys, liveliness tokens, attachments. Pure.

A node or endpoint is in the ROS graph while its liveliness token exists, and a sample counts only
with its attachment. Source: github.com/ros2/rmw_zenoh, `docs/design.md` and
`src/detail/liveliness_utils.cpp`, `attachment_helpers.cpp`.
"""

import re
import struct
from dataclasses import dataclass
from enum import Enum

import xxhash

from teleop.ros.message_types import compute_type_hash

RELIABLE, BEST_EFFORT = 1, 2  # rmw_qos_reliability_policy_e
_ATTACHMENT = struct.Struct("<qqB16s")
_GID_BYTES = 16
_NAME = re.compile(r"(?:/[A-Za-z_][A-Za-z0-9_]*)+")


@dataclass(frozen=True, slots=True)
class Qos:
    """Quality of service of an endpoint, volatile and `keep last`."""

    reliability: int = RELIABLE
    depth: int = 10

    @property
    def text(self) -> str:
        """The policies in a token; those of rmw_zenoh's default are left out."""
        reliability = "" if self.reliability == RELIABLE else str(self.reliability)
        return f"{reliability}::,{self.depth}:,:,:,,"


class EndpointKind(Enum):
    """Kinds of endpoints in a token."""

    PUBLISHER = "MP"
    SUBSCRIBER = "MS"


@dataclass(frozen=True, slots=True)
class Node:
    """A node of ours: one for each Zenoh session."""

    domain: int
    zid: str  # of the Zenoh session, as it prints it
    name: str

    @property
    def key(self) -> str:
        """The key of its liveliness token."""
        return f"{self._build_key('0')}/NN/%/%/{self.name}"

    def build_endpoint_key(
        self, number: int, kind: EndpointKind, topic: str, type_name: str, qos: Qos
    ) -> str:
        """Return the key of the liveliness token of its endpoint `number`, from 1."""
        entity = self._build_key(str(number))
        return (
            f"{entity}/{kind.value}/%/%/{self.name}/{topic.replace('/', '%')}/"
            f"{to_dds_name(type_name)}/{compute_type_hash(type_name)}/{qos.text}"
        )

    def _build_key(self, number: str) -> str:
        return f"@ros2_lv/{self.domain}/{self.zid}/0/{number}"


@dataclass(frozen=True, slots=True)
class GraphEndpoint:
    """A publisher or subscriber of others, from its liveliness token."""

    node: str  # with its namespace
    kind: EndpointKind
    topic: str
    type: str  # such as sensor_msgs/msg/JointState


def is_name(topic: str) -> bool:
    """Return whether this is a full name of a topic, such as `/lab/slave/measured_js`."""
    return _NAME.fullmatch(topic) is not None


def build_topic_key(domain: int, topic: str, type_name: str) -> str:
    """Return the key of a topic's samples."""
    return f"{domain}/{topic.strip('/')}/{to_dds_name(type_name)}/{compute_type_hash(type_name)}"


def to_dds_name(type_name: str) -> str:
    """Return the name of a type on the wire: `sensor_msgs::msg::dds_::JointState_`."""
    package, _, name = type_name.partition("/msg/")
    return f"{package}::msg::dds_::{name}_"


def compute_gid(token: str) -> bytes:
    """Return the global id of an entity: XXH3-128 of its token, the low word first."""
    return xxhash.xxh3_128_intdigest(token.encode()).to_bytes(_GID_BYTES, "little")


def pack_attachment(sequence: int, stamp_ns: int, publisher_gid: bytes) -> bytes:
    """Return the attachment of a sample: its number from 1, the time of sending, the publisher."""
    return _ATTACHMENT.pack(sequence, stamp_ns, _GID_BYTES, publisher_gid)


def parse_attachment(data: bytes) -> tuple[int, int, bytes] | None:
    """Return number, time [ns] and publisher of a sample; None if it has no such attachment."""
    if len(data) != _ATTACHMENT.size:
        return None
    sequence, stamp_ns, size, publisher_gid = _ATTACHMENT.unpack(data)
    return (sequence, stamp_ns, publisher_gid) if size == _GID_BYTES else None


def parse_endpoint(token: str) -> GraphEndpoint | None:
    """Return the endpoint that a liveliness token announces; None if it is of something else."""
    parts = token.split("/")
    if len(parts) < 13 or parts[5] not in {kind.value for kind in EndpointKind}:
        return None
    namespace, name = parts[7].replace("%", "/").rstrip("/"), parts[8]
    package, _, short = parts[10].partition("::msg::dds_::")
    topic = parts[9].replace("%", "/")
    return GraphEndpoint(
        f"{namespace}/{name}", EndpointKind(parts[5]), topic, f"{package}/msg/{short[:-1]}"
    )
