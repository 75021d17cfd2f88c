"""A stranger who has only the page writes valid messages: nothing of ours builds them."""

import random
import re
import struct
import zlib

import pytest

from docs.messages_page import format_page
from teleop.messages import messages
from teleop.messages.topics import TOPICS

PLACED = re.compile(r"\| (\d+) \| `(\w+)` \| (\w+)(?:\[(\d+)\])? \|")  # byte, field, type, count
HEX = re.compile(r"^[0-9a-f]{4}  ((?:[0-9a-f]{2} ?)+)$", re.MULTILINE)


class Stranger:
    """Writes messages as the page says, with `struct` and `zlib`."""

    def __init__(self, text):
        self.sections = dict(re.findall(r"^## (.+?)\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.S))
        head, write = self.sections["The head"], self.sections["Write a message"]
        self.encapsulation = bytes.fromhex(re.search(r"are `([0-9a-f ]+)` in", head)[1])
        self.layout = int(re.search(r"In this version `([0-9a-f]{8})`", head)[1], 16)
        self.codes = dict(re.findall(r"\| (\w+) \| \d+ \| `(<\w)` \|", write))
        rows = re.findall(r"\| (\w+) \| (\d+) \| `([0-9a-f]{8})` \|", write)
        self.sizes = {name: int(size) for name, size, _ in rows}
        self.seeds = {name: int(seed, 16) for name, _, seed in rows}
        self.head = self.fields(head)
        topics = re.findall(r"\| `(\w+)` \| \[(\w+)\]", self.sections["Topics"])
        self.topics = dict(topics)
        self.example = bytes.fromhex("".join(HEX.findall(write)))

    def fields(self, section):
        """Return field -> (byte, struct code, count) of a section's table."""
        return {
            name: (int(byte), self.codes[kind], int(count or 0))
            for byte, name, kind, count in PLACED.findall(section)
        }

    def body(self, name):
        """Return the fields of a message after the head."""
        return self.fields(self.sections[name])

    def write(self, name, values):
        """Return a message with these values, others zero."""
        data = bytearray(self.sizes[name])
        data[: len(self.encapsulation)] = self.encapsulation
        places = self.head | self.body(name)
        for field, value in ({"layout": self.layout} | values).items():
            byte, code, count = places[field]
            size = struct.calcsize(code)
            for k, item in enumerate(value if count else [value]):
                struct.pack_into(code, data, byte + k * size, item)
        struct.pack_into("<I", data, 4, zlib.crc32(data[8:], self.seeds[name]))
        return bytes(data)


@pytest.fixture(scope="module")
def stranger():
    return Stranger(format_page())


def random_value(draw, code):
    if code == "<d":
        return draw.uniform(-1e3, 1e3)
    low, high = {"<q": (-(2**63), 2**63 - 1)}.get(code, (0, 256 ** struct.calcsize(code) - 1))
    return draw.randint(low, high)


@pytest.mark.parametrize("cls", messages.MESSAGES, ids=lambda cls: cls.__name__)
def test_a_message_written_from_the_page_alone_is_accepted(stranger, cls):
    draw, name = random.Random(cls.__name__), cls.__name__  # noqa: S311
    places = {k: v for k, v in (stranger.head | stranger.body(name)).items() if k != "checksum"}
    values = {
        field: [random_value(draw, code) for _ in range(count)]
        if count
        else random_value(draw, code)
        for field, (_, code, count) in places.items()
        if field != "layout"
    }
    read = cls.unpack(stranger.write(name, values))
    assert set(places) | {"checksum"} == set(cls.schema.wires)
    for field, value in values.items():
        got = getattr(read, field)
        assert (list(got) if isinstance(value, list) else got) == value


def test_the_example_is_what_the_page_says_of_it(stranger):
    rows = re.findall(
        r"^\| \d+ \| `(\w+)` \| (?:`(\w+)`|\"(.*)\"|(\d+)) \|$",
        stranger.sections["Write a message"],
        re.MULTILINE,
    )
    values = {
        field: int(hexadecimal, 16) if hexadecimal else text.encode() if text else int(number)
        for field, hexadecimal, text, number in rows
    }
    assert len(values) == 6
    assert stranger.write("EmergencyStop", values) == stranger.example
    stop = messages.EmergencyStop.unpack(stranger.example)
    assert messages.decode_text(stop.text) == "a switch by the door"
    damaged = bytearray(stranger.example)
    damaged[60] ^= 1
    with pytest.raises(messages.MessageError):
        messages.EmergencyStop.unpack(bytes(damaged))


def test_the_page_has_every_key(stranger):
    assert stranger.topics == {topic.name: topic.message.__name__ for topic in TOPICS}
    assert "`teleop/<session>/<topic>`" in stranger.sections["Write a message"]
