"""The server for the Foxglove app, seen by a client of the WebSocket protocol alone (RFC 6455)."""

import base64
import hashlib
import json
import os
import socket
import struct
import urllib.parse
from xml.etree import ElementTree

import numpy as np
import pytest

from teleop.messages.topics import STATE, TOPICS
from teleop.ros.message_types import JOINT_STATE
from teleop.ros.output_topics import OUTPUTS, build_topic_name
from teleop.view.foxglove_server import FoxgloveServer
from tests.root import ROOT
from tests.teleop.recorded import heard

PATIENCE_S = 20.0


class Client:
    """What the app does: connect, be told of channels, subscribe, receive."""

    def __init__(self, url, origin="https://app.foxglove.dev", host=None):
        address = urllib.parse.urlsplit(url)
        self.host = address.hostname
        self._socket = socket.create_connection((self.host, address.port), PATIENCE_S)
        key = base64.b64encode(os.urandom(16)).decode()
        self._socket.sendall(
            f"GET {address.path} HTTP/1.1\r\nHost: {host or address.netloc}\r\n"
            f"Origin: {origin}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n".encode()
        )
        self._data = b""
        while b"\r\n\r\n" not in self._data:
            self._data += self._socket.recv(4096)
        answer, _, self._data = self._data.partition(b"\r\n\r\n")
        self.status = int(answer.split()[1])
        assert self.status != 101 or accepted(key) in answer.decode()

    def close(self):
        self._socket.close()

    def send(self, message):
        text = json.dumps(message).encode()
        assert len(text) < 126
        mask = os.urandom(4)
        masked = bytes(byte ^ mask[k % 4] for k, byte in enumerate(text))
        self._socket.sendall(bytes((0x81, 0x80 | len(text))) + mask + masked)

    def receive(self, wanted):
        """Return the next message of an operation (text), or the next binary one (None)."""
        while True:
            opcode, content = self._frame()
            if opcode == 2 and wanted is None and content[0] == 1:
                return content
            if opcode == 1 and json.loads(content).get("op") == wanted:
                return json.loads(content)

    def _frame(self):
        first, length = self._take(2)
        if length == 126:
            (length,) = struct.unpack(">H", self._take(2))
        elif length == 127:
            (length,) = struct.unpack(">Q", self._take(8))
        return first & 0x0F, self._take(length)

    def _take(self, size):
        while len(self._data) < size:
            self._data += self._socket.recv(65536)
        taken, self._data = self._data[:size], self._data[size:]
        return taken


def accepted(key):
    """What a server proves with that it speaks WebSocket (RFC 6455, 4.2.2)."""
    guid = b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11"
    return base64.b64encode(hashlib.sha1(key.encode() + guid).digest()).decode()  # noqa: S324


def test_the_app_gets_the_bytes_of_the_link_with_their_definition():
    message = heard(STATE, 3, np.random.default_rng(1))
    with FoxgloveServer("demo", 8765) as server:
        client = Client(server.url)
        try:
            assert client.host == "127.0.0.1"
            channels = {c["topic"]: c for c in client.receive("advertise")["channels"]}
            assert set(channels) == {f"/{topic.name}" for topic in TOPICS}
            state = channels["/state"]
            assert (state["encoding"], state["schemaEncoding"]) == ("cdr", "ros2msg")
            assert state["schemaName"] == "tendon_teleop/msg/SlaveState"
            assert state["schema"] == STATE.message.schema.ros_definition
            client.send({"op": "subscribe", "subscriptions": [{"id": 7, "channelId": state["id"]}]})
            client._socket.settimeout(0.05)
            for _ in range(400):  # until the subscription is known to the server
                assert server.forward(lambda: [message]) == [message]
                try:
                    content = client.receive(None)
                except TimeoutError:
                    continue
                break
            assert struct.unpack_from("<IQ", content, 1) == (7, message.stamp_ns)
            assert content[13:] == message.data
        finally:
            client.close()


@pytest.mark.parametrize(
    "asked",
    [
        {"origin": "https://evil.example"},
        {"origin": "null"},
        {"host": "rebound.example:8765"},
        {"path": "/guess/"},
    ],
)
def test_nobody_else_is_let_in(asked):
    with FoxgloveServer("demo", 8765) as server:
        own = urllib.parse.urlsplit(server.url)
        path = asked.pop("path", own.path)
        client = Client(f"ws://{own.netloc}{path}", **asked)
        client.close()
        assert client.status == 403


@pytest.mark.parametrize("frame", [b"\x81\x02{}", b"\x82\xff" + b"\xff" * 12, b"\x81\x82abcd12"])
def test_what_is_no_frame_of_the_protocol_ends_that_connection_only(frame):
    with FoxgloveServer("demo", 8765) as server:
        client = Client(server.url)
        client._socket.sendall(frame)
        client._socket.shutdown(socket.SHUT_WR)
        while client._socket.recv(65536):
            pass
        client.close()
        other = Client(server.url)
        assert other.receive("serverInfo")["capabilities"] == []
        other.close()


def field_of(message, text):
    """Whether a message has the field, and the array the element, of `name` or `name[k]`."""
    name, _, index = text.rstrip("]").partition("[")
    return name in message.schema.wires and int(index or 0) < message.schema.wires[name].count


def test_the_layouts_name_what_there_is():
    topics = {f"/{topic.name}": topic.message for topic in TOPICS}
    layout = json.loads((ROOT / "configs" / "foxglove-layout.json").read_text())
    panels = layout["configById"].values()
    paths = [path["value"] for panel in panels for path in panel.get("paths", ())]
    assert len(paths) > 8
    for path in paths:
        topic, _, text = path.partition(".")
        assert field_of(topics[topic], text), path
    outputs = {build_topic_name(output.name, ""): output for output in OUTPUTS}
    tree = ElementTree.parse(ROOT / "configs" / "plotjuggler-layout.xml")  # noqa: S314 - ours
    for curve in tree.iter("curve"):
        topic, _, rest = curve.get("name").rpartition("/")
        if topic in outputs:
            assert field_of(outputs[topic].source.message, rest), curve.get("name")
        else:  # /topic/joint/field, as PlotJuggler names the signals of a JointState
            assert outputs[topic.rpartition("/")[0]].type == JOINT_STATE
            assert rest in ("position", "velocity", "effort")
