"""Records of a pull, and how the reader refuses one."""

import numpy as np
import pytest

from teleop.data.measured_table import read_table, write_table
from teleop.errors import UsageError


def pull(path, **columns):
    """Write a pull of 1 s at 100 Hz, with further columns."""
    time = np.arange(101) / 100
    tension = 5.0 - 4.0 * np.cos(6.0 * time)
    write_table(path, {"time_s": time, "proximal_tension_N": tension} | columns)
    return time, tension


def refusal(path, text=None, **options):
    """Return the one line with which a file, or text written to it, is refused."""
    if text is not None:
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(UsageError) as caught:
        read_table(path, **options)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    return message
