"""The Zenoh session of a ROS node: apart from the link, a client of the router on this machine.

A client listens nowhere and is reached by nobody but its router. Through the router of `rmw_zenoh`
everything arrives at a client; a peer without gossip, as on our link, gets nothing.
"""

import socket
from collections.abc import Callable
from typing import Any

import zenoh

from teleop.errors import TeleopError
from teleop.link.config import Endpoint
from teleop.link.network import LEASE_MS, OPEN_MS, RETRY_MS, to_zenoh_config

_CONNECT_TIMEOUT_S = 0.5  # [s] for a connection on this machine

RawSampleCallback = Callable[[bytes, bytes], None]
"""Called from Zenoh's thread with the payload of a sample and its attachment."""


def find_router_problem(router: str) -> str:
    """Return that nothing listens at a router's endpoint, and what starts one; empty if it does."""
    endpoint = Endpoint.parse(router)
    try:
        with socket.create_connection((endpoint.host, endpoint.port), _CONNECT_TIMEOUT_S):
            return ""
    except OSError:
        return f"no router at {router} yet: ros2 run rmw_zenoh_cpp rmw_zenohd"


class RosSession:
    """A client of one router, which must be there; after a loss it connects again by itself.

    `router` is an endpoint, such as `tcp/127.0.0.1:7447`; `zid` the id of the Zenoh session. Raises
    `TeleopError` if there is no router (`find_router_problem` tells without waiting).
    """

    def __init__(self, router: str) -> None:
        settings: dict[str, Any] = {
            "mode": "client",
            "scouting/multicast/enabled": False,
            "connect/endpoints": [router],
            "connect/timeout_ms": OPEN_MS,
            "connect/exit_on_failure": True,
            "connect/retry": {
                "period_init_ms": RETRY_MS,
                "period_max_ms": 10 * RETRY_MS,
                "period_increase_factor": 2,
            },
            "transport/unicast/open_timeout": OPEN_MS,
            "transport/shared_memory/enabled": False,
            "transport/link/protocols": ["tcp"],
            "transport/link/tx/lease": LEASE_MS,
        }
        try:
            self._zenoh: Any = zenoh.open(to_zenoh_config(settings))
        except zenoh.ZError as error:
            raise TeleopError(f"ros.router: what listens at {router} is no Zenoh router") from error
        self.zid = str(self._zenoh.info.zid())
        self._liveliness: Any = self._zenoh.liveliness()
        self._declared: list[Any] = []

    def declare_token(self, key: str) -> None:
        """Keep a liveliness token until the session is closed."""
        self._declared.append(self._liveliness.declare_token(key))

    def declare_publisher(self, key: str, reliable: bool) -> "RosSampleSender":
        """Return a publisher that never waits: a sample is dropped if the router is too slow."""
        kind = zenoh.Reliability.RELIABLE if reliable else zenoh.Reliability.BEST_EFFORT
        publisher: Any = self._zenoh.declare_publisher(
            key,
            encoding=zenoh.Encoding.APPLICATION_CDR,
            congestion_control=zenoh.CongestionControl.DROP,
            reliability=kind,
        )
        return RosSampleSender(publisher)

    def subscribe(self, key: str, receive: RawSampleCallback) -> None:
        """Pass each sample of a key, which may be a pattern, to `receive`."""

        def on_sample(sample: Any) -> None:
            attachment = sample.attachment
            receive(sample.payload.to_bytes(), attachment.to_bytes() if attachment else b"")

        self._declared.append(self._zenoh.declare_subscriber(key, on_sample))

    def watch_tokens(self, pattern: str, changed: Callable[[str, bool], None]) -> None:
        """Call `changed` with each token of `pattern` and whether it has come, or else gone."""

        def on_token(sample: Any) -> None:
            changed(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        watch = self._liveliness.declare_subscriber(pattern, on_token, history=True)
        self._declared.append(watch)

    def close(self) -> None:
        """Take back all tokens and leave."""
        self._zenoh.close()


class RosSampleSender:
    """Sends the samples of one topic."""

    def __init__(self, publisher: Any) -> None:
        self._publisher = publisher

    @property
    def has_subscriber(self) -> bool:
        """Whether anyone listens; always true where the router does not say."""
        return bool(self._publisher.matching_status.matching)

    def put(self, payload: bytes, attachment: bytes) -> None:
        """Send a sample."""
        self._publisher.put(payload, attachment=attachment)
