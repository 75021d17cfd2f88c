"""A router, and a subscriber of plain Zenoh that shares no code with the nodes."""

import contextlib
import json
import socket
from collections import defaultdict

import zenoh


def free_port():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


@contextlib.contextmanager
def router(endpoint=None):
    """A Zenoh session in the role of `rmw_zenohd`; yields its endpoint."""
    endpoint = endpoint or f"tcp/127.0.0.1:{free_port()}"
    config = zenoh.Config()
    for key, value in {
        "mode": "router",
        "listen/endpoints": [endpoint],
        "scouting/multicast/enabled": False,
    }.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config):
        yield endpoint


@contextlib.contextmanager
def peer(endpoint):
    """A session as a ROS node's: a peer with gossip, connected to the router."""
    config = zenoh.Config()
    for key, value in {
        "mode": "peer",
        "connect/endpoints": [endpoint],
        "listen/endpoints": ["tcp/127.0.0.1:0"],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
    }.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        yield session


class Heard:
    """All samples of a domain, by topic: (type and hash, payload, attachment); and its tokens."""

    def __init__(self, session, domain=0):
        self.samples = defaultdict(list)
        self.tokens = set()
        self._kept = [
            session.declare_subscriber(f"{domain}/**", self._on_sample),
            session.liveliness().declare_subscriber(
                f"@ros2_lv/{domain}/**", self._on_token, history=True
            ),
        ]

    def _on_sample(self, sample):
        topic, name, type_hash = str(sample.key_expr).split("/", 1)[1].rsplit("/", 2)
        attachment = sample.attachment.to_bytes()
        self.samples[f"/{topic}"].append(((name, type_hash), sample.payload.to_bytes(), attachment))

    def _on_token(self, sample):
        came = sample.kind == zenoh.SampleKind.PUT
        (self.tokens.add if came else self.tokens.discard)(str(sample.key_expr))
