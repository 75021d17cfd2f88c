"""From commanded tip travel to motor positions.

The command of a joint is a travel of its tip; its tendon is moved by as much from where the motor
stood when the session engaged, so engaging never moves anything by itself.
"""

from collections.abc import Sequence
from typing import NamedTuple


class Control(NamedTuple):
    """Memory of the controller; `origin` is None until the session engages."""

    origin: tuple[float, ...] | None = None  # [m] motor position less command, at engagement


def step(
    memory: Control, command: Sequence[float], motor: Sequence[float], engaged: bool
) -> tuple[tuple[float, ...], Control]:
    """Return the motor positions wanted [m] and the new memory.

    Parameters
    ----------
    command : sequence of float
        Tip travel asked for [m], one for each tendon.
    motor : sequence of float
        Motor position the gate last let through [m].
    engaged : bool
        Whether commands count. While they do not, the motors are wanted where they are.
    """
    if not engaged:
        return tuple(motor), Control()
    origin = memory.origin
    if origin is None:
        origin = tuple(m - c for m, c in zip(motor, command, strict=True))
    return tuple(c + o for c, o in zip(command, origin, strict=True)), Control(origin)
