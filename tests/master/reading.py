"""What a device says when it is read."""

from master.device import DeviceLost
from studies.testbed.processes import wait_for_condition


def said(device):
    """Return what the device says against itself; empty if it is read."""
    try:
        device.read(0.0)
    except DeviceLost as error:
        return str(error)
    return ""


def reads(device):
    return said(device) == ""


def comes_back(device):
    return wait_for_condition(lambda: reads(device), 30.0)
