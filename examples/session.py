"""A session from Python: start slave and master, and read the force at the tip.

    python examples/session.py

A scripted hand pulls a simulated finger against a wall; everything runs on loopback.
"""

import subprocess
import sys
import time

from teleop.link import Link, LinkConfig
from teleop.messages.topics import STATE, Role
from teleop.session.state_machine import State

HOST = "127.0.0.1:"
SHARED = ["--set", "session=example", "--set", f"link.master={HOST}7661"]
SHARED += ["--set", f"link.slave={HOST}7662", "--set", "slave.calibration=as-built"]
sides = [subprocess.Popen([sys.executable, "-m", "teleop", side, *SHARED]) for side in
         ("slave", "master")]  # fmt: skip
try:
    endpoints = LinkConfig(master=f"{HOST}7661", slave=f"{HOST}7662")
    with Link(endpoints, "example", Role.WATCH) as link:
        link.subscribe_latest(STATE)
        most, begun = 0.0, None
        while begun is None or time.monotonic() - begun < 3.0:
            time.sleep(0.01)
            message = link.latest(STATE).message
            if message is not None and message.state == State.ENGAGED:
                begun = begun or time.monotonic()
                most = max(most, message.force[0])
    print(f"engaged for 3 s; the largest force at the tip was {most:.1f} N")
finally:
    for side in sides:
        side.terminate()
    for side in sides:
        side.wait()
