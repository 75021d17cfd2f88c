"""A recording as numpy columns: how well the master followed, and what was felt.

    python examples/read_recording.py session.mcap

`teleop run --record` makes one; every tool that reads MCAP with ROS 2 messages opens it too.
"""

import sys

import numpy as np

from teleop.recording.reader import open_recording, read_columns
from teleop.session.state_machine import State

path = sys.argv[1]
info = open_recording(path)
print(f"{path}: {info.seconds:.1f} s, topics {', '.join(sorted(info.messages))}")

state = read_columns(path, "state")
engaged = state["state"] == State.ENGAGED
force, low, high = (state[name][:, 0] for name in ("force", "force_low", "force_high"))
print(f"{len(state['force'])} states, engaged in {engaged.mean():.0%} of them")
width = np.nanmean(high - low)
print(f"force at the tip: {np.nanmin(force):.2f} to {np.nanmax(force):.2f} N,")
print(f"known to within {width:.2f} N on average")
