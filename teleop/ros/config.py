"""The `ros` section of a config file."""

import re
from dataclasses import dataclass

from teleop.config.ranges import build_ranged_field, check_ranges
from teleop.config.suggestions import suggest_spelling
from teleop.errors import UsageError
from teleop.link.config import Address, Endpoint, LinkConfig
from teleop.ros.graph import is_name
from teleop.ros.output_topics import OUTPUTS

ALL = tuple(output.name for output in OUTPUTS)
DOMAIN_MAX = 232  # of ROS 2


@dataclass(frozen=True, slots=True)
class RosConfig:
    """What a session shows to ROS 2, and where."""

    start: bool = False  # whether `teleop run` starts `teleop ros` too
    # ROS_DOMAIN_ID of the nodes that are to see it
    domain: int = build_ranged_field(0, 0, DOMAIN_MAX)
    router: str = "tcp/127.0.0.1:7447"  # of rmw_zenoh, on this machine
    node: str = "tendon_teleop"  # name of the node
    prefix: str = ""  # before the names of topics and frames, such as /lab
    # of the topics that follow the loops; 1 to 500
    rate_hz: float = build_ranged_field(100.0, 1.0, 500.0, "Hz")
    topics: tuple[str, ...] = ALL  # names of the topics that are published

    def __post_init__(self) -> None:
        check_ranges(self)
        check_router(self.router)
        if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", self.node):
            raise ValueError("node: allowed are letters, digits and _")
        if self.prefix and not is_name(self.prefix):
            raise ValueError("prefix: must be empty or a name such as /lab")
        for i, topic in enumerate(self.topics):
            if topic not in ALL:
                raise ValueError(f"topics.{i}: no topic {topic!r}{suggest_spelling(topic, ALL)}")


def check_router(router: str) -> None:
    """Check the endpoint of the router; raises `ValueError`."""
    try:
        endpoint = Endpoint.parse(router)
    except ValueError as error:
        raise ValueError(f"router: {error}") from error
    if not endpoint.loopback or endpoint.protocol != "tcp":
        raise ValueError(
            "router: must be tcp on loopback; let the router of this machine connect to others"
        )


def check_ports(router: str, link: LinkConfig) -> None:
    """Raise `UsageError` if the router's endpoint is one of the link's."""
    port = Endpoint.parse(router).port
    for name in ("master", "slave"):
        address = Address.parse(getattr(link, name))
        if address.loopback and address.port == port:
            raise UsageError(
                f"ros.router: {router}: link.{name} has this port; set another one in link.{name}"
            )
