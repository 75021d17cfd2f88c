"""A session from Python: the program is the operator, and pulls until it feels the tissue.

    python examples/session.py

The robot is simulated, everything runs on loopback.
"""

from teleop import Session

with Session(operator=True, calibration="as-built") as session:
    session.wait_for("ready")
    session.operator.engage()
    session.wait_for("engaged")
    position, force_max = 0.0, 0.0
    for state in session.states(duration=3.0):
        position += 0.03 * 0.001  # [m] 3 cm a second
        session.operator.move(position)
        force_max = max(force_max, state.force[0])
    session.mark("pulled")
print(f"engaged for 3 s; the largest force at the tip was {force_max:.1f} N")
print(f"the slave ran at {session.summary.slave.rate_hz:.0f} Hz")
