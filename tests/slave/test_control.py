"""From tip travel to motor positions."""

from hypothesis import given
from hypothesis import strategies as st

from slave.control import Control, step

metres = st.floats(-0.1, 0.1)


@given(command=metres, motor=metres)
def test_engaging_moves_nothing(command, motor):
    wanted, memory = step(Control(), (command,), (motor,), engaged=True)
    assert abs(wanted[0] - motor) < 1e-15
    assert memory.origin is not None


@given(command=metres, motor=metres, travel=metres)
def test_engaged_the_motor_follows_the_command_one_to_one(command, motor, travel):
    _, memory = step(Control(), (command,), (motor,), engaged=True)
    wanted, _ = step(memory, (command + travel,), (motor,), engaged=True)
    assert abs(wanted[0] - (motor + travel)) < 1e-15


def test_not_engaged_the_motor_stays_and_the_origin_is_forgotten():
    _, memory = step(Control(), (0.0,), (0.01,), engaged=True)
    wanted, memory = step(memory, (0.05,), (0.02,), engaged=False)
    assert wanted == (0.02,)
    assert memory.origin is None
