"""The node against the fake: its quirks must come out as reports or as `DeviceFault`."""

import sys

import pytest

from master.device import DeviceFault
from master.devices.hid.node import QUEUE_LENGTH, Node, load_hidapi
from studies.hid.descriptors import openffboard
from studies.hid.virtual.openffboard import OpenFFBoard


@pytest.fixture
def plugged(hidraw):
    node = hidraw.plug(OpenFFBoard(openffboard()))
    node.talking = False
    return node


@pytest.fixture
def node(plugged):
    node = Node(str(plugged.path), "stick")
    yield node
    node.close()


def test_a_full_queue_is_told_by_its_length(node, plugged):
    plugged.push(*(bytes((1, k)) for k in range(80)))
    reports = node.drain()
    assert len(reports) == QUEUE_LENGTH
    assert reports[-1] == bytes((1, 63))  # the newest are the ones that are lost


def test_one_call_takes_no_more_than_a_queue_however_fast_they_come(hidraw, node, plugged):
    plugged.talking = True
    start, ticks = hidraw.clock(), iter(range(1, 10**6))
    hidraw.clock = lambda: start + next(ticks) * 0.010
    assert len(node.drain()) == QUEUE_LENGTH


@pytest.mark.parametrize("call", ["write", "send_feature"])
def test_a_report_that_is_not_taken_is_a_fault(hidraw, node, plugged, call):
    getattr(node, call)(bytes((0x0D, 255)))
    hidraw.unplug(plugged)
    with pytest.raises(DeviceFault, match="stick"):
        getattr(node, call)(bytes((0x0D, 255)))


def test_an_unplugged_device_is_a_fault_on_the_next_read(hidraw, node, plugged):
    hidraw.unplug(plugged)
    with pytest.raises(DeviceFault, match="stick: was unplugged"):
        node.drain()
    with pytest.raises(DeviceFault):
        node.get_feature(0x13, 5)
    with pytest.raises(DeviceFault):
        node.read_descriptor()


def test_a_closed_node_is_a_fault_and_closing_again_is_nothing(node):
    node.close()
    node.close()
    with pytest.raises(DeviceFault):
        node.drain()
    with pytest.raises(DeviceFault):
        node.write(b"\x0d\xff")


def test_a_node_that_cannot_be_opened_is_a_fault(plugged):
    plugged.permitted = False
    with pytest.raises(DeviceFault, match=r"stick: cannot be opened; teleop devices rules \| sudo"):
        Node(str(plugged.path), "stick")
    with pytest.raises(DeviceFault, match="stick: cannot be opened; it was unplugged: plug it in"):
        Node(f"{plugged.path}-gone", "stick")


def test_on_linux_it_is_the_hidraw_module_and_without_it_one_line_says_so(monkeypatch, hidraw):
    assert load_hidapi() is hidraw
    monkeypatch.setitem(sys.modules, "hidraw", None)
    with pytest.raises(DeviceFault, match="pip install hidapi"):
        load_hidapi()
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setitem(sys.modules, "hid", hidraw)
    assert load_hidapi() is hidraw
