"""The topics by which a ROS node commands a session, and who publishes them. Pure.

The master takes them only if its config says so (`master.device: {type: ros}`): then it has a
subscriber in the graph. Without one, commands are refused: nobody reads them.
"""

import threading

from teleop.ros.graph import EndpointKind, GraphEndpoint
from teleop.ros.output_topics import build_topic_name

SERVO_TOPICS = {command: f"master/{command}" for command in ("servo_jp", "servo_cv", "servo_cp")}
STATE_COMMAND = "master/state_command"


class CommandTopics:
    """Tracks publishers and subscribers of the command topics; Zenoh's thread writes."""

    def __init__(self, prefix: str) -> None:
        self._names = {
            build_topic_name(name, prefix) for name in (*SERVO_TOPICS.values(), STATE_COMMAND)
        }
        self._lock = threading.Lock()
        self._there: dict[EndpointKind, list[tuple[str, str]]] = {kind: [] for kind in EndpointKind}

    def note(self, endpoint: GraphEndpoint, came: bool) -> None:
        """Note that an endpoint has come, or gone."""
        if endpoint.topic not in self._names:
            return
        with self._lock:
            endpoints, entry = self._there[endpoint.kind], (endpoint.topic, endpoint.node)
            if came:
                endpoints.append(entry)
            elif entry in endpoints:
                endpoints.remove(entry)

    def describe_refused(self) -> str:
        """Return which commands nobody takes, and the remedy; empty if there are none."""
        with self._lock:
            subscribed = {topic for topic, _ in self._there[EndpointKind.SUBSCRIBER]}
            refused = sorted(
                e for e in self._there[EndpointKind.PUBLISHER] if e[0] not in subscribed
            )
        if not refused:
            return ""
        names = ", ".join(f"{node} publishes {topic}" for topic, node in dict.fromkeys(refused))
        return f"refused: {names}; the master has no device of type ros that takes it"
