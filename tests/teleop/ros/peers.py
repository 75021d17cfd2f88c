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


def open_zenoh(mode, **settings):
    """A session without multicast; in the name of a setting, __ stands for /."""
    config = zenoh.Config()
    for key, value in ({"mode": mode, "scouting__multicast__enabled": False} | settings).items():
        config.insert_json5(key.replace("__", "/"), json.dumps(value))
    return zenoh.open(config)


@contextlib.contextmanager
def router(endpoint=None):
    """A Zenoh session in the role of `rmw_zenohd`; yields its endpoint."""
    endpoint = endpoint or f"tcp/127.0.0.1:{free_port()}"
    with open_zenoh("router", listen__endpoints=[endpoint]):
        yield endpoint


def peer(endpoint):
    """A session as a ROS node's: a peer with gossip, connected to the router."""
    return open_zenoh(
        "peer",
        connect__endpoints=[endpoint],
        listen__endpoints=["tcp/127.0.0.1:0"],
        scouting__gossip__enabled=True,
    )


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
