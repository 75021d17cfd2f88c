"""All joints of one side of a coupling; the functions are compiled and change it in place."""

from collections.abc import Sequence
from typing import Annotated

from estimator.array_types import Array
from estimator.compiled import compiled
from estimator.records import F64, U64, Field, Flag, Record
from teleop.coupling import direct, passivity, wave
from teleop.coupling import port as ledger
from teleop.coupling.config import PASSIVITY, WAVE, BilateralSettings
from teleop.coupling.interface import MasterInput, SlaveInput, SlaveOutput
from teleop.coupling.port import Port
from teleop.messages import MAX_JOINTS


class Side(Record):
    """What one side of a coupling remembers from one tick to the next.

    Told to the other side are `ports[k].passed_on` [J] and `ports[k].told_wave` [sqrt(J s)].
    """

    ports: Annotated[Sequence[Port], Field(Port, MAX_JOINTS)]
    sender: U64 = 0  # nonce of the other side
    coupled: Flag = False  # whether forces are rendered (master), tips follow (slave)
    requested: Annotated[Array, Field("f8", MAX_JOINTS)]  # [m] where the hand asked the tips to be
    tip: Annotated[Array, Field("f8", MAX_JOINTS)]  # [m] where they were sent instead, if coupled
    hand: Annotated[Sequence[MasterInput], Field(MasterInput, MAX_JOINTS)]  # counted last (master)
    dt: F64 = 0.0  # [s] of that tick


@compiled
def receive(side: Side, sender: int, energy: Array, wave: Array) -> None:
    """Take in what the other side tells.

    Parameters
    ----------
    sender : int
        Its nonce; another one than before is counted from its first word.
    energy, wave : ndarray
        Sums passed on [J] and waves sent [sqrt(J s)], shape (MAX_JOINTS,).
    """
    if sender != side.sender:
        for k in range(MAX_JOINTS):
            ledger.forget(side.ports[k])
    for k in range(MAX_JOINTS):
        ledger.receive(side.ports[k], energy[k], wave[k])
    side.sender = sender


@compiled
def rest(settings: BilateralSettings, side: Side) -> None:
    """Keep all ports of a side that is not coupled at the reserve."""
    for k in range(MAX_JOINTS):
        ledger.rest(side.ports[k], settings.reserve)


@compiled
def count_hand(
    settings: BilateralSettings,
    side: Side,
    place: Array,
    velocity: Array,
    written: Array,
    axes: int,
    lever: float,
    coupled: bool,
    dt: float,
) -> None:
    """Count what the hand did since the last tick: the master's first phase.

    After it `passed_on` and `sent_wave` of the ports are what the next command tells; `render` is
    the second phase. Nothing here depends on the force that the tips feel now.

    Parameters
    ----------
    place, velocity : ndarray
        Where the hand is [m] and goes [m/s], shape (MAX_JOINTS,), in units of the tip; only how far
        it went counts.
    written : ndarray
        What was rendered since the last tick [N], of the first `axes`.
    axes : int
        Axes of the device.
    lever : float
        Damping on the device for a damping at the tip: the product of both scales.
    coupled : bool
        Whether forces are rendered.
    dt : float
        Time since the last tick [s].
    """
    if not coupled:
        for k in range(axes):  # by a force that fades
            ledger.count_work(side.ports[k], written[k] * (place[k] - side.requested[k]))
        rest(settings, side)
    elif not side.coupled:
        rest(settings, side)
    for k in range(axes):
        hand = side.hand[k]
        hand.written = written[k]
        # how fast the hand moves when it is coupled tells what it may be given
        before = side.requested[k] if side.coupled else place[k] - velocity[k] * dt
        hand.travel = place[k] - before
        hand.velocity = velocity[k]
        hand.dragged = 0.0
        if lever * dt > 0.0:
            # by the smaller of two measures: noise in one of them is no damping
            dragged = min(hand.travel * hand.velocity, hand.travel * hand.travel / dt)
            hand.dragged = max(dragged, 0.0) / lever
        if coupled:
            if settings.kind == PASSIVITY:
                passivity.count_hand(settings.passivity, side.ports[k], hand)
            elif settings.kind == WAVE:
                wave.count_hand(settings.wave, side.ports[k], hand, dt)
            else:
                direct.count_hand(side.ports[k], hand)
    for k in range(MAX_JOINTS):
        side.requested[k] = place[k]
        side.tip[k] = place[k]
    side.coupled = coupled
    side.dt = dt


@compiled
def render(
    settings: BilateralSettings, side: Side, force: Array, axes: int, rendered: Array
) -> None:
    """Work out the forces that the hand shall feel: the master's second phase.

    Uses the energy ledger as `count_hand` left it, plus what `receive` added since.

    Parameters
    ----------
    force : ndarray
        What the tips feel [N], as told, of the first `axes`.
    axes : int
        Axes of the device.
    rendered : ndarray
        Overwritten with the forces [N] in tip units, of the first `axes`; if the side is not
        coupled they are `force` as it is. May be the same array as `force`.
    """
    for k in range(axes):
        if side.coupled and settings.kind == PASSIVITY:
            rendered[k] = passivity.render(
                settings.passivity, side.ports[k], side.hand[k], force[k], side.dt
            )
        elif side.coupled and settings.kind == WAVE:
            rendered[k] = wave.render(settings.wave, side.ports[k], side.hand[k], force[k], side.dt)
        else:
            rendered[k] = force[k]


@compiled
def at_tip(
    settings: BilateralSettings,
    side: Side,
    requested: Array,
    velocity: Array,
    force: Array,
    joints: int,
    coupled: bool,
    dt: float,
) -> None:
    """Work out where the tips shall be [m] and go [m/s], in place of what is asked.

    At the tick at which they are first coupled they shall be where they are asked to be.

    Parameters
    ----------
    requested, velocity : ndarray
        By the hand [m], [m/s], of the first `joints`; overwritten with where the tips shall be and
        go. If they are not coupled, they stay as they are.
    force : ndarray
        What the tips feel [N], of the first `joints`.
    joints : int
        Joints of the rig.
    coupled : bool
        Whether the tips follow.
    dt : float
        Time since the last tick [s].
    """
    if not coupled or not side.coupled:
        rest(settings, side)
        for k in range(joints):
            side.requested[k] = requested[k]
            side.tip[k] = requested[k]
        side.coupled = coupled
        return
    for k in range(joints):
        place = side.tip[k]
        before = side.requested[k]
        tip = SlaveInput(force[k], requested[k] - before, before - place, velocity[k])
        output = _follow(settings, side.ports[k], tip, dt)
        side.requested[k] = requested[k]
        side.tip[k] = place + output.travel
        requested[k] = side.tip[k]
        velocity[k] = output.velocity


@compiled
def _follow(settings: BilateralSettings, port: Port, tip: SlaveInput, dt: float) -> SlaveOutput:
    if settings.kind == PASSIVITY:
        return passivity.at_tip(settings.passivity, port, tip, dt)
    if settings.kind == WAVE:
        return wave.at_tip(settings.wave, port, tip, dt)
    return direct.at_tip(port, tip)
