"""Serve the messages of a session to the Foxglove app: the CDR bytes as they are, on loopback.

A server of the Foxglove WebSocket protocol (github.com/foxglove/ws-protocol) that can do what is
needed here and nothing else: it names channels and sends what a client subscribes to. No message of
a client has any other effect, and who may connect is decided as for the page (`LocalServer`): the
secret is in the address. Channels are those of a recording, so a layout of the app shows both.
"""

import base64
import hashlib
import json
import struct
import threading
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any, ClassVar, Self

from mcap.well_known import MessageEncoding, SchemaEncoding

from teleop.errors import UsageError
from teleop.link import ReceivedMessage
from teleop.messages.messages import SCHEMA_PACKAGE
from teleop.messages.topics import TOPICS
from teleop.recording.scan import to_channel_name
from teleop.view.local_server import GuardedHandler, LocalServer

_PROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")  # the same for what is used here
# origins of the app in a browser, and installed
_APP_ORIGINS = ("https://app.foxglove.dev", "file://")
_GUID = "258EAFA5-E914-47DA-95CA-C5AB0DC85B11"  # RFC 6455
_TEXT, _BINARY, _CLOSE, _PING, _PONG = 1, 2, 8, 9, 10  # opcodes
_QUEUE = 2048  # messages that wait for a slow app; then the oldest go
_CLIENT_FRAME_MAX = 65536  # [bytes] of a client's frame at most
_CHANNELS = {topic.name: number for number, topic in enumerate(TOPICS, start=1)}


class FoxgloveServer:
    """A running server, as a context manager.

    The app shows the name of the `session`, and opens `url`; another port than `port` is taken if
    that is in use. Raises `UsageError` if it cannot listen.
    """

    def __init__(self, session: str, port: int) -> None:
        self._clients: set[_Client] = set()

        class Handler(_Handler):
            clients = self._clients
            name = f"teleop {session}"

        try:
            self._server = LocalServer(Handler, port)
        except OSError as error:
            raise UsageError(f"--foxglove: cannot listen near port {port}: {error}") from error
        self.url = f"ws://{self._server.address}"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for client in list(self._clients):
            client.close()
        self._server.close()

    def forward(self, drain: Callable[[], list[ReceivedMessage]]) -> list[ReceivedMessage]:
        """Return the messages of `drain`, passed on under the times at which they were sent."""
        messages = drain()
        for client in list(self._clients):
            for message in messages:
                client.publish(message)
        return messages


class _Client:
    """What is to be sent to an app: frames that wait, sent by a thread of its own."""

    def __init__(self, handler: GuardedHandler) -> None:
        self._handler = handler
        self.subscriptions: dict[int, int] = {}  # channel -> the client's number of it
        self._frames: deque[bytes] = deque(maxlen=_QUEUE)
        self._wake = threading.Condition()
        self._open = True

    def send(self, opcode: int, content: bytes) -> None:
        """Let a frame be sent; the oldest that waits is dropped if there are too many."""
        size = len(content)
        long = size > 0xFFFF
        head = bytes((0x80 | opcode, size if size < 126 else 127 if long else 126))
        head += b"" if size < 126 else struct.pack(">Q" if long else ">H", size)
        with self._wake:
            self._frames.append(head + content)
            self._wake.notify()

    def publish(self, message: ReceivedMessage) -> None:
        """Send a message of the link if its channel was subscribed to."""
        number = self.subscriptions.get(_CHANNELS[message.topic.name])
        if number is not None:
            head = struct.pack("<BIQ", 1, number, message.stamp_ns)
            self.send(_BINARY, head + message.data)

    def close(self) -> None:
        """Let the thread end."""
        with self._wake:
            self._open = False
            self._wake.notify()

    def run(self) -> None:
        """Send frames until it is closed."""
        while True:
            with self._wake:
                self._wake.wait_for(lambda: self._frames or not self._open)
                if not self._open:
                    return
                frames = b"".join(self._frames)
                self._frames.clear()
            try:
                self._handler.wfile.write(frames)
            except OSError:
                return


class _Handler(GuardedHandler):
    clients: set[_Client]
    name = ""
    origins = _APP_ORIGINS
    timeout: ClassVar[float | None] = None  # an app that only listens says nothing

    def answer(self, path: str) -> None:
        """Become a WebSocket, name the channels, and heed what the client subscribes to."""
        offered = self.headers.get("Sec-WebSocket-Protocol", "").replace(" ", "").split(",")
        protocol = next((name for name in _PROTOCOLS if name in offered), None)
        key = self.headers.get("Sec-WebSocket-Key")
        if path or protocol is None or key is None:
            self.send_error(400, "is no connection of the Foxglove app")
            return
        self.close_connection = True
        proof = hashlib.sha1(f"{key}{_GUID}".encode(), usedforsecurity=False).digest()
        self.send_response(101)
        self.send_header("Upgrade", "websocket")
        self.send_header("Connection", "Upgrade")
        self.send_header("Sec-WebSocket-Accept", base64.b64encode(proof).decode())
        self.send_header("Sec-WebSocket-Protocol", protocol)
        self.end_headers()
        client = _Client(self)
        client.send(_TEXT, _encode_message(op="serverInfo", name=self.name, capabilities=[]))
        client.send(_TEXT, _encode_message(op="advertise", channels=_build_channels()))
        with ExitStack() as stack:
            self.clients.add(client)
            stack.callback(self.clients.discard, client)
            stack.callback(client.close)
            threading.Thread(target=client.run, name="foxglove", daemon=True).start()
            while self._handle_frame(client, *self._read_frame()):
                pass

    def _handle_frame(self, client: _Client, opcode: int, content: bytes) -> bool:
        """Do what a client's frame says; returns whether there may be another."""
        if opcode == _PING:
            client.send(_PONG, content)
        elif opcode == _TEXT:
            try:
                _update_subscriptions(client.subscriptions, json.loads(content))
            except (ValueError, KeyError, TypeError, RecursionError):
                return False  # not the protocol
        return opcode != _CLOSE

    def _read_frame(self) -> tuple[int, bytes]:
        """Return opcode and content of the client's next frame; a close if there is none."""
        first, second = self._read_bytes(2) or (_CLOSE, 0)
        size = second & 0x7F
        if size > 125:
            size = int.from_bytes(self._read_bytes(2 if size == 126 else 8) or b"\xff" * 8)
        if not second & 0x80 or size > _CLIENT_FRAME_MAX:  # a client masks what it sends
            return _CLOSE, b""
        mask = self._read_bytes(4)
        content = self._read_bytes(size)
        if not mask or len(content) < size:
            return _CLOSE, b""
        key = (mask * (size // 4 + 1))[:size]
        unmasked = int.from_bytes(content) ^ int.from_bytes(key)
        return first & 0x0F, unmasked.to_bytes(size)

    def _read_bytes(self, size: int) -> bytes:
        """Return as many bytes; none if the client has gone."""
        try:
            content = self.rfile.read(size)
        except OSError:
            return b""
        return content if len(content) == size else b""


def _update_subscriptions(subscriptions: dict[int, int], message: dict[str, Any]) -> None:
    if message["op"] == "subscribe":
        for item in message["subscriptions"]:
            if item["channelId"] in _CHANNELS.values():
                subscriptions[item["channelId"]] = int(item["id"]) & 0xFFFFFFFF
    elif message["op"] == "unsubscribe":
        for channel, number in list(subscriptions.items()):
            if number in message["subscriptionIds"]:
                del subscriptions[channel]


def _build_channels() -> list[dict[str, object]]:
    return [
        {
            "id": _CHANNELS[topic.name],
            "topic": to_channel_name(topic.name),
            "encoding": str(MessageEncoding.CDR),
            "schemaName": f"{SCHEMA_PACKAGE}/msg/{topic.message.schema.name}",
            "schemaEncoding": str(SchemaEncoding.ROS2),
            "schema": topic.message.schema.ros_definition,
        }
        for topic in TOPICS
    ]


def _encode_message(**message: object) -> bytes:
    return json.dumps(message).encode()
