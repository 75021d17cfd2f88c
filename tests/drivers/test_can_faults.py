"""Faults of a CAN bus are told apart: what is wrong, and the next step."""

import contextlib
import json
import threading
import time
from pathlib import Path

import can
import pytest

from slave.drivers import driver_table
from slave.drivers.cia402 import bring_up, bus
from slave.drivers.cia402.bring_up import Cia402Reader
from slave.drivers.cia402.config import BusConfig, Cia402Config
from slave.drivers.cia402.driver import Cia402Driver
from slave.drivers.cia402.monitor import BusMonitor, find_interface_fault
from slave.drivers.driver import Channels, DriverFault
from studies.rigs.models.drives import Drives, SlcanAdapter
from studies.rigs.models.line import PseudoPort
from tests.drivers.bench import cia402, running

NO_ACKNOWLEDGE = "no node acknowledges frames: are the drives powered and connected, bit rate"


class FieldDrives(Drives):
    """Drives behind an slcan adapter, as they may be found.

    Attributes
    ----------
    answer : callable
        Takes a frame that they would hear; whether they do not.
    """

    def __init__(self, numbers=(1,)):
        port = PseudoPort()
        self.port_name, self.answer = port.name, lambda _message: False
        super().__init__(SlcanAdapter(port), numbers=numbers)

    def _receive(self, wait_s):
        message = super()._receive(wait_s)
        return None if message is not None and self.answer(message) else message

    def send(self, identifier, data):
        self.bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))

    def answer_by_heartbeats(self, number, first=0):
        """Answer nothing but a heartbeat for each request to a node, behind the first ones."""

        def answer(message):
            nonlocal first
            if message.arbitration_id != 0x600 + number:
                return False
            first -= 1
            if first < 0:
                self.send(0x700 + number, b"\x7f")
            return first < 0

        self.answer = answer


@pytest.fixture
def drives():
    with running(FieldDrives()) as drives:
        yield drives
    drives.bus.shutdown()


def reader(port_name, numbers=(1,)):
    return contextlib.closing(Cia402Reader(cia402(port_name), Channels(numbers, numbers, True)))


def start_error(port_name, numbers=(1,)):
    """Return what reading the drives fails with."""
    with reader(port_name, numbers) as opened, pytest.raises(DriverFault) as fault:
        opened.start()
    return str(fault.value)


def cycle_on(driver):
    until_s = time.monotonic() + 5.0
    while time.monotonic() < until_s:
        driver.run_cycle(None)


def test_a_node_that_is_alive_but_does_not_answer_is_told_from_one_that_is_not_there(drives):
    assert "drive 3 does not answer: no frame arrives: power" in start_error(drives.port_name, (3,))
    drives.answer_by_heartbeats(1, first=1)
    said = "drive 1 is alive (heartbeat), but does not answer SDO requests: switch it off and on"
    assert said in start_error(drives.port_name)


def test_two_nodes_of_one_number_are_named_by_every_command(drives, monkeypatch):
    monkeypatch.setattr(bring_up, "NODE_NUMBER_MAX", 3)
    monkeypatch.setattr(bring_up, "ANSWER_S", 0.5)  # a busy machine holds the drives up
    send = drives.bus.send

    def send_twice(message, timeout=None):
        send(message, timeout)
        if message.arbitration_id == 0x581:
            send(message, timeout)

    config = cia402(drives.port_name)
    (line,) = driver_table.scan(config)
    assert line == "node 1: model of a drive, profile 402, switch on disabled"
    drives.bus.send = send_twice
    said = "drive 1 answers each request twice: two nodes have this number: connect one at a time"
    (line,) = driver_table.scan(config)
    assert line.startswith(said)
    for motors, cells, read_only in (((1,), (), True), ((1,), (), False), ((), (1,), False)):
        driver = driver_table.open_driver(config, Channels(motors, cells, read_only))
        with pytest.raises(DriverFault, match=said), contextlib.closing(driver):
            driver.start()


def test_an_answer_of_another_object_is_named_as_one_of_two_nodes_or_programs(drives):
    drives.answer = lambda message: (
        message.arbitration_id == 0x601
        and (drives.send(0x581, bytes.fromhex("4b41600037020000")) or True)
    )
    said = start_error(drives.port_name)
    assert "object 1000:0: an answer to another request came: another program speaks to it" in said


def test_an_answer_that_comes_too_late_is_named(drives):
    def delay(message):
        if message.arbitration_id == 0x601:
            late = bytes.fromhex("43001000") + (0x192).to_bytes(4, "little")
            threading.Timer(0.4, drives.send, (0x581, late)).start()
        return message.arbitration_id == 0x601

    drives.answer = delay
    assert "drive 1 answers SDO requests later than 300 ms" in start_error(drives.port_name)


def abort(drives, wanted, code):
    """Let the drive refuse a download to the object of these three bytes."""

    def answer(message):
        data = bytes(message.data)
        refused = message.arbitration_id == 0x601 and data[0] & 0xE0 == 0x20 and data[1:4] == wanted
        if refused:
            drives.send(0x581, b"\x80" + wanted + code.to_bytes(4, "little"))
        return refused

    drives.answer = answer


def test_a_mapping_that_is_refused_is_named_by_its_object_and_bits(drives):
    abort(drives, bytes.fromhex("001a02"), 0x06040041)
    driver = Cia402Driver(cia402(drives.port_name), Channels((1,), ()))
    with pytest.raises(DriverFault) as fault, contextlib.closing(driver):
        driver.start()
    assert str(fault.value) == (
        "drive 1 object 1A00:2 = 6064:0, 32 bits: Code 0x06040041, Object cannot be mapped to the "
        "PDO: its mapping is fixed: choose a mapping with these objects by its own tool"
    )


def test_an_emergency_ends_reading_too(drives):
    with reader(drives.port_name) as opened:
        opened.start()
        opened.run_cycle(None)
        drives.send(0x81, bytes.fromhex("2082") + bytes(6))
        with pytest.raises(DriverFault, match=r"^drive 1 reports: PDO length exceeded.*0x8220"):
            cycle_on(opened)


class Adapter:
    """An slcan adapter that answers each frame with `answer`."""

    def __init__(self, answer):
        self.port, self.answer, self.ended = PseudoPort(), answer, False
        self.thread = threading.Thread(target=self.serve)
        self.thread.start()

    def serve(self):
        received = b""
        while not self.ended:
            received += self.port.read(0.01)
            *lines, received = received.split(b"\r")
            for line in lines:  # set-up commands may be refused, too
                self.port.write(self.answer if line[:1] in (b"t", b"r") else b"\a")
        self.port.unplug()


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (b"\a", NO_ACKNOWLEDGE),
        (b"\r", "no frame arrives: power, cable, number, bit rate (1000000)?"),
        (b"t1x8\xff\r", "damaged lines of the adapter: is tty_baud right?"),
    ],
)
def test_what_an_adapter_answers_tells_why_nobody_else_does(answer, said):
    adapter = Adapter(answer)
    try:
        assert said in start_error(adapter.port.name)
    finally:
        adapter.ended = True
        adapter.thread.join()


def frame(identifier, data=b"", error=False):
    return can.Message(
        arbitration_id=identifier, data=data, is_error_frame=error, is_extended_id=False
    )


@pytest.mark.parametrize(
    ("frames", "said"),
    [
        ([frame(0x20, bytes(8), True)], "does not answer: no node acknowledges frames"),
        ([frame(0x04, bytes([0, 0x20]) + bytes(6), True)], NO_ACKNOWLEDGE),
        (
            [frame(0x88, bytes([0, 0, 4, 0x0A]) + bytes(4), True)],
            "does not answer: frames are damaged",
        ),
        (
            [frame(0x04, bytes([0, 0x10]) + bytes(6), True)],
            "another bit rate (500000 in the config)",
        ),
        ([frame(0x40, bytes(8), True)], "does not answer: bus off: check bit rate, termination"),
        ([frame(0x02, bytes(8), True)], "does not answer: no frame arrives"),  # arbitration lost
        ([frame(0x705, b"\5"), frame(0x184, bytes(8))], "does not answer: nodes 4, 5 are alive"),
        ([frame(0x701, b"\5")], "is alive (heartbeat), but does not answer"),
        ([frame(0x81, b"\x10\x81" + bytes(6))], "and reports: CAN overrun, messages lost (0x8110)"),
        ([frame(0x80, b"")], "no frame arrives"),  # SYNC
    ],
)
def test_silence_is_explained_by_what_else_is_heard(frames, said):
    monitor = BusMonitor(BusConfig(bitrate=500_000))
    for each in frames:
        monitor.on_message_received(each)
    assert said in monitor.explain_silence(1, 0.3)


def test_errors_of_the_bus_are_forgotten_once_all_have_answered():
    monitor = BusMonitor(BusConfig())
    monitor.on_message_received(frame(0x68, bytes(8), True))
    assert monitor.explain_errors()
    monitor.forget_errors()
    assert monitor.explain_errors() == ""


LINK = json.loads(  # of `ip -details -json link show dev can0`, iproute2 6.1
    '[{"ifindex":4,"ifname":"can0","flags":["NOARP","UP","LOWER_UP","ECHO"],"mtu":16,"operstate":'
    '"UP","link_type":"can","linkinfo":{"info_kind":"can","info_data":{"state":"ERROR-ACTIVE",'
    '"berr_counter":{"tx":0,"rx":0},"restart_ms":0,"bittiming":{"bitrate":500000,"sample_point":'
    '"0.875"},"clock":8000000}}}]'
)[0]


def changed(**values):
    about = LINK["linkinfo"]["info_data"] | values
    return LINK | {"linkinfo": {"info_kind": "can", "info_data": about}}


@pytest.mark.parametrize(
    ("interface", "bitrate", "said"),
    [
        (LINK, 500_000, ""),
        ({}, 500_000, ""),  # no iproute2
        ({"flags": ["UP"], "linkinfo": {"info_kind": "vcan"}}, 500_000, ""),
        (
            LINK,
            1_000_000,
            "runs at 500000 bit/s, bus.bitrate is 1000000: correct that, or: sudo ip",
        ),
        (
            LINK | {"flags": ["NOARP", "ECHO"]},
            500_000,
            "is down: sudo ip link set can0 up type can bitrate 500000",
        ),
        (
            changed(state="BUS-OFF"),
            500_000,
            "bus off: check bit rate, termination (120 ohm at both ends) and cable; then: sudo ip "
            "link set can0 down; sudo ip link set can0 up",
        ),
    ],
)
def test_an_interface_that_carries_no_frames_is_named_with_the_command(interface, bitrate, said):
    fault = find_interface_fault(interface, BusConfig(bitrate=bitrate))
    assert fault.startswith(said)
    assert bool(fault) is bool(said)


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (
            can.CanOperationError("down", 100),
            "the interface is down, or bus off.*ip link set can7 up",
        ),
        (OSError(19, "No such device"), "no such interface, or .* unplugged: there is can1, can2$"),
        (
            OSError(97, "Address family not supported"),
            "this kernel has no SocketCAN: sudo modprobe",
        ),
        (can.CanOperationError("x"), "CAN can7: x: adapter unplugged, bus off, or no drive"),
    ],
)
def test_an_error_number_of_the_system_is_told_with_the_next_step(monkeypatch, error, said):
    def refuse(**_):
        raise error

    interfaces = [Path("can1"), Path("can2")]
    monkeypatch.setattr("slave.drivers.ports.list_can_interfaces", lambda: interfaces)
    config = Cia402Config(bus=BusConfig(channel="can7"))
    with pytest.raises(DriverFault, match=said):
        raise bus.to_driver_fault(config, error)
    if not isinstance(error, can.CanError):
        monkeypatch.setattr(can, "Bus", refuse)
        with pytest.raises(DriverFault, match=f"cannot be opened as socketcan: {said}"):
            bus.open_bus(config)


def test_silence_while_running_is_told_with_the_reason(drives):
    driver = Cia402Driver(cia402(drives.port_name), Channels((1,), ()))
    with contextlib.closing(driver):
        driver.start()
        driver.run_cycle(None)
        drives.silent = True
        drives.bus.port.write(b"\a" * 3)
        with pytest.raises(DriverFault, match=rf"node 1 silent for \d+ ms: {NO_ACKNOWLEDGE}"):
            cycle_on(driver)


@pytest.mark.parametrize("interface", ["pcan", "gs_usb"])
def test_an_interface_without_its_library_is_told_with_those_that_need_none(interface):
    config = Cia402Config(bus=BusConfig(interface=interface, channel="0"))
    with pytest.raises(
        DriverFault, match=f"opened as {interface}: .*; most USB adapters.*to socke"
    ):
        bus.open_bus(config)
