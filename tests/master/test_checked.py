"""A device of another package: what it gets wrong is named, and felt by nobody."""

from dataclasses import dataclass

import numpy as np
import pytest

from master.device import DeviceFault, DeviceLost, HandState
from master.devices import open_device
from master.devices.combined import CombinedConfig
from master.devices.extension import DeviceExtension
from teleop.errors import UsageError

FOUR = (0.0, 0.1, 0.2, 0.3)


class Pen:
    """Returns what it is told to."""

    def __init__(self, returned, axes=4):
        self.returned, self.axes, self.closed = returned, axes, 0

    def read(self, _time_s):
        if isinstance(self.returned, Exception):
            raise self.returned
        return self.returned

    def write(self, _force):
        raise OSError("cable")

    def close(self):
        self.closed += 1


@dataclass(frozen=True)
class PenConfig(DeviceExtension):
    type: str = "mylab"
    device: object = None

    def open(self):
        return self.device


def opened(returned):
    return open_device(PenConfig(device=Pen(returned)))


def test_what_is_right_is_passed_on_as_it_is():
    for pressed in (True, False, np.True_, np.False_):
        hand = HandState(FOUR, FOUR, engage=pressed, stop=pressed)
        assert opened(hand).read(0.0) is hand


@pytest.mark.parametrize(
    ("returned", "said"),
    [
        (HandState(FOUR[:3], FOUR, True), "position has 3 numbers, must have 4, one an axis"),
        (HandState(np.ones(4), FOUR, True), "position is a ndarray, must be a tuple of floats"),
        (HandState(FOUR, (0, 0, 0, "1"), True), "position .*: must be floats"),
        (None, "returned NoneType, must be HandState"),
        (HandState(FOUR, FOUR, True, buttons=2), "buttons is 2, must be a tuple of numbers from 1"),
        (HandState(FOUR, FOUR, None), "engage is None, must be a bool"),
        (
            HandState(FOUR, FOUR, True, stop=np.zeros(1)),
            r"stop is array\(\[0\.\]\), must be a bool",
        ),
    ],
)
def test_a_hand_that_is_wrong_is_named_by_field_with_what_it_must_be(returned, said):
    with pytest.raises(DeviceFault, match=f"^mylab: Pen.read: {said}") as caught:
        opened(returned).read(0.0)
    assert not isinstance(caught.value, DeviceLost)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_value_that_is_not_finite_is_a_fault_from_which_the_device_may_return(value):
    device = opened(HandState(FOUR, (*FOUR[:3], value), True))
    with pytest.raises(DeviceLost, match=rf"velocity \(0\.0, 0\.1, 0\.2, {value}\), not finite"):
        device.read(0.0)


def test_what_its_code_raises_is_a_fault_with_the_place_in_that_code():
    device = opened(KeyError("axis"))
    with pytest.raises(DeviceFault, match=r"mylab: read fails: KeyError: 'axis' \(.*, line \d+\)"):
        device.read(0.0)
    with pytest.raises(DeviceFault, match="mylab: write fails: OSError: cable"):
        device.write(FOUR)
    with pytest.raises(DeviceLost, match=r"^unplugged$"):
        opened(DeviceLost("unplugged")).read(0.0)


def test_a_device_that_fails_to_close_is_warned_of_and_replaces_no_fault(capsys):
    def fail(_):
        raise OSError("cable")

    device = open_device(PenConfig(device=type("Loose", (Pen,), {"close": fail})(None)))
    device.close()
    assert "WARNING: mylab: close fails: OSError: cable (" in capsys.readouterr().err


def test_a_device_that_is_none_is_named_at_opening():
    with pytest.raises(UsageError, match=r"^master\.device: mylab: object has no axes, read, wr"):
        open_device(PenConfig(device=object()))


def test_one_of_several_is_checked_too():
    right = HandState(FOUR, FOUR, True)
    parts = (PenConfig(device=Pen(right)), PenConfig(device=Pen(HandState(FOUR[:2], FOUR, True))))
    device = open_device(CombinedConfig(devices=parts))
    with pytest.raises(DeviceFault, match=r"^devices\.1: mylab: Pen.read: position has 2 numbers"):
        device.read(0.0)


@pytest.mark.parametrize("axes", [-1, 0, 9])
def test_a_device_whose_axes_are_no_joints_is_named_and_closed(axes):
    pen = Pen(None, axes)
    said = rf"^master\.device: mylab has {axes} axes, must be 1 to 8$"
    with pytest.raises(UsageError, match=said):
        open_device(PenConfig(device=pen))
    assert pen.closed == 1


@pytest.mark.parametrize("axes", [0, 6])
def test_devices_that_have_more_axes_together_than_joints_are_named_and_closed(axes):
    pens = [Pen(None, 3), Pen(None, axes)]
    config = CombinedConfig(devices=tuple(PenConfig(device=pen) for pen in pens))
    said = rf"^master\.device: devices\.1: mylab has {axes} axes, must be 1 to 5$"
    with pytest.raises(UsageError, match=said):
        open_device(config)
    assert [pen.closed for pen in pens] == [1, 1]
