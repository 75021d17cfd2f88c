"""Serve the messages of a session to the Foxglove app: the CDR bytes as they are, on loopback.

Channels are those of a recording, so a layout of the app shows both. The package `foxglove-sdk` is
optional: the extra `foxglove`.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Self

from mcap.well_known import MessageEncoding, SchemaEncoding

from teleop.errors import UsageError
from teleop.link import ReceivedMessage
from teleop.recording.names import SCHEMA_PACKAGE, channel_name
from teleop.topics import TOPICS
from teleop.view.feed import Messages
from teleop.view.ports import LOOPBACK, free_port


class FoxgloveServer:
    """A running server, as a context manager.

    Parameters
    ----------
    session : str
        Name of the session, which the app shows.
    port : int
        Preferred port; a free one if it is in use.

    Raises
    ------
    UsageError
        The package is not installed, or the server cannot listen.

    Attributes
    ----------
    url : str
        What to open in the app.
    """

    def __init__(self, session: str, port: int) -> None:
        foxglove = _package()
        self._context = context = foxglove.Context()  # channels end with it
        self._channels = {}
        for topic in TOPICS:
            schema = topic.message.schema
            self._channels[topic.name] = foxglove.Channel(
                channel_name(topic.name),
                schema=foxglove.Schema(
                    name=f"{SCHEMA_PACKAGE}/msg/{schema.name}",
                    encoding=SchemaEncoding.ROS2,
                    data=schema.ros_definition.encode(),
                ),
                message_encoding=MessageEncoding.CDR,
                context=context,
            )
        with _one_line(port):
            self._server: Any = foxglove.start_server(
                name=f"teleop {session}", host=LOOPBACK, port=free_port(port), context=context
            )
        self.url = f"ws://{LOOPBACK}:{self._server.port}"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._server.stop()

    def publish(self, message: ReceivedMessage) -> None:
        """Pass a message on, under the time at which it was sent."""
        self._channels[message.topic.name].log(message.data, log_time=message.stamp_ns)

    def forwarding(self, source: Messages) -> Messages:
        """Return a source that passes on what is taken from it."""
        return _Forwarding(self, source)


class _Forwarding:
    def __init__(self, server: FoxgloveServer, source: Messages) -> None:
        self._server, self._source = server, source

    def drain(self) -> list[ReceivedMessage]:
        """Return the messages since the last call, after passing them on."""
        messages = self._source.drain()
        for message in messages:
            self._server.publish(message)
        return messages


def _package() -> Any:
    try:
        import foxglove
    except ImportError as error:
        raise UsageError(
            "--foxglove needs the package foxglove-sdk: pip install 'tendon-teleop[foxglove]'"
        ) from error
    return foxglove


@contextmanager
def _one_line(port: int) -> Iterator[None]:
    try:
        yield
    except (OSError, RuntimeError, ValueError) as error:
        raise UsageError(f"--foxglove: cannot listen near port {port}: {error}") from error
