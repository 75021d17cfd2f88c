"""A node in the ROS graph: its publishers and subscribers on a Zenoh session of its own."""

from collections.abc import Callable
from typing import Self

from teleop.link.ros_session import RosSampleSender, RosSession
from teleop.ros import graph
from teleop.ros.graph import RELIABLE, EndpointKind, GraphEndpoint, Node, Qos
from teleop.runtime.clock import now_ns

SampleCallback = Callable[[bytes, bytes, int], None]
"""Takes the bytes of a sample, the global id of its publisher, and when it was sent [ns]."""


class RosNode:
    """A node, as a context manager.

    `domain` is ROS_DOMAIN_ID; the `name` of the node is without a namespace.
    """

    def __init__(self, router: str, domain: int, name: str) -> None:
        self._session = RosSession(router)
        self._node = Node(domain, self._session.zid, name)
        self._endpoints = 0
        self._session.declare_token(self._node.key)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._session.close()

    def advertise(self, topic: str, type_name: str, qos: Qos) -> "RosPublisher":
        """Return a publisher of a topic."""
        key = graph.build_topic_key(self._node.domain, topic, type_name)
        samples = self._session.declare_publisher(key, qos.reliability == RELIABLE)
        return RosPublisher(
            samples,
            graph.compute_gid(self._announce(EndpointKind.PUBLISHER, topic, type_name, qos)),
        )

    def subscribe(self, topic: str, type_name: str, qos: Qos, receive: SampleCallback) -> None:
        """Pass each sample of a topic to `receive`, in Zenoh's thread.

        A sample without the attachment of rmw_zenoh is not one of a ROS node, and is ignored.
        """

        def on_sample(data: bytes, attachment: bytes) -> None:
            sender = graph.parse_attachment(attachment)
            if sender is not None:
                _, sent_ns, publisher = sender
                receive(data, publisher, sent_ns)

        self._session.subscribe(
            graph.build_topic_key(self._node.domain, topic, type_name), on_sample
        )
        self._announce(EndpointKind.SUBSCRIBER, topic, type_name, qos)

    def watch(self, changed: Callable[[GraphEndpoint, bool], None]) -> None:
        """Call `changed` with each endpoint of other nodes and whether it has come or gone."""

        def on_token(key: str, came: bool) -> None:
            endpoint = graph.parse_endpoint(key)
            if endpoint is not None and f"/{self._node.zid}/" not in key:
                changed(endpoint, came)

        self._session.watch_tokens(f"@ros2_lv/{self._node.domain}/**", on_token)

    def _announce(self, kind: EndpointKind, topic: str, type_name: str, qos: Qos) -> str:
        self._endpoints += 1
        key = self._node.build_endpoint_key(self._endpoints, kind, topic, type_name, qos)
        self._session.declare_token(key)
        return key


class RosPublisher:
    """Publishes one topic; `sent` messages so far.

    `wanted` is whether anyone subscribed at the last `look`.
    """

    def __init__(self, samples: RosSampleSender, gid: bytes) -> None:
        self._samples, self._gid = samples, gid
        self.sent = 0
        self.wanted = True

    def look(self) -> None:
        """Update `wanted`: whether anyone subscribes."""
        self.wanted = self._samples.has_subscriber

    def put(self, data: bytes) -> None:
        """Publish the bytes of a message."""
        self.sent += 1
        self._samples.put(data, graph.pack_attachment(self.sent, now_ns(), self._gid))
