"""SpaceMouse: both forms, bytes by hand."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from master.devices.hid.driver import Controls
from master.devices.hid.joystick import SpaceMouseDriver

DRIVER = SpaceMouseDriver()
REST = Controls((0.0,) * 6, 0, 0)


def decoded(*reports, start=REST):
    controls = start
    for report in reports:
        controls = DRIVER.decode(controls, bytes(report))
    return controls


def test_the_newer_form_has_six_axes_in_one_report():
    # 350 = 5E 01, -350 = A2 FE, 175 = AF 00, -175 = 51 FF
    report = (1, 0x5E, 1, 0xA2, 0xFE, 0xAF, 0, 0x51, 0xFF, 0, 0, 0x5E, 1)
    assert decoded(report).axes == (1.0, -1.0, 0.5, -0.5, 0.0, 1.0)


def test_the_older_form_has_three_and_three():
    moved = decoded((1, 0x5E, 1, 0xA2, 0xFE, 0xAF, 0))
    assert moved.axes == (1.0, -1.0, 0.5, 0.0, 0.0, 0.0)
    turned = decoded((2, 0x51, 0xFF, 0, 0, 0x5E, 1), start=moved)
    assert turned.axes == (1.0, -1.0, 0.5, -0.5, 0.0, 1.0)
    assert decoded((1, 0, 0, 0, 0, 0, 0), start=turned).axes == (0.0, 0.0, 0.0, -0.5, 0.0, 1.0)


def test_an_old_one_that_reaches_further_ends_at_full_scale():
    assert decoded((1, 0xF4, 1, 0x0C, 0xFE, 0, 0)).axes[:2] == (1.0, -1.0)  # 500, -500


def test_buttons_come_alone_and_leave_the_axes():
    held = decoded((1, 0x5E, 1, 0, 0, 0, 0), (3, 0b10, 0b1))
    assert held == Controls((1.0, 0.0, 0.0, 0.0, 0.0, 0.0), 0b1_0000_0010, (1 << 32) - 1)
    assert decoded((3, 0, 0), start=held).buttons == 0


@pytest.mark.parametrize("report", [(), (1,), (1, 1, 1, 1), (2, 9), (3,), (0x17, 80, 1), (9,) * 13])
def test_what_is_none_of_these_changes_nothing(report):
    assert decoded(report) is REST


def test_it_is_never_told_to_push():
    assert DRIVER.forces == ()
    assert DRIVER.encode((), arm=True) == DRIVER.silence() == ()


@given(st.binary(max_size=16))
def test_whatever_comes_shares_are_shares(report):
    controls = DRIVER.decode(REST, report)
    assert len(controls.axes) == 6
    assert all(-1.0 <= share <= 1.0 for share in controls.axes)
    assert 0 <= controls.buttons < 1 << DRIVER.buttons
