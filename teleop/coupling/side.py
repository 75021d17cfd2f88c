"""All joints of one side of a coupling; compiled functions that update it in place."""

import math
from collections.abc import Sequence
from typing import Annotated

from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.structs import F64, U64, Field, Flag, Struct
from teleop.coupling import contact, direct, energy_ledger, passivity, wave
from teleop.coupling.config import EXTENSION, PASSIVITY, WAVE, BilateralSettings
from teleop.coupling.contact import Contact
from teleop.coupling.energy_ledger import Port
from teleop.coupling.interface import MasterInput, SlaveInput, SlaveOutput
from teleop.messages.messages import MAX_JOINTS


class Side(Struct):
    """State of one side of a coupling between ticks.

    Messages carry `ports[k].passed_on` [J] and `ports[k].sent_wave` [sqrt(J s)].
    """

    ports: Annotated[Sequence[Port], Field(Port, MAX_JOINTS)]
    sender: U64 = 0  # nonce of the other side
    coupled: Flag = False  # whether forces are rendered (master), tips follow (slave)
    requested: Annotated[Array, Field("f8", MAX_JOINTS)]  # [m] tip positions commanded by the hand
    tip: Annotated[Array, Field("f8", MAX_JOINTS)]  # [m] tip positions after the coupling
    # at the last tick (master)
    hand: Annotated[Sequence[MasterInput], Field(MasterInput, MAX_JOINTS)]
    dt: F64 = 0.0  # [s] of that tick
    # [m] of the command, beyond the largest speed and not made up for (slave)
    dropped: Annotated[Array, Field("f8", MAX_JOINTS)]
    # of a coupling of another package, at this tick: [m], [m/s] of the tips, [N] for the hand
    own_position: Annotated[Array, Field("f8", MAX_JOINTS)]
    own_velocity: Annotated[Array, Field("f8", MAX_JOINTS)]
    own_force: Annotated[Array, Field("f8", MAX_JOINTS)]
    contacts: Annotated[Sequence[Contact], Field(Contact, MAX_JOINTS)]  # of the tips (master)


@jit_compile
def receive_totals(side: Side, sender: int, energy: Array, wave: Array) -> None:
    """Process the totals of the other side.

    `sender` is its nonce; a new one is counted from its first message. `energy` [J] and `wave`
    [sqrt(J s)] are the sums passed on and the waves sent, shape (MAX_JOINTS,).
    """
    if sender != side.sender:
        for k in range(MAX_JOINTS):
            energy_ledger.reset_received_totals(side.ports[k])
            contact.reset_contact(side.contacts[k])
    for k in range(MAX_JOINTS):
        energy_ledger.receive_totals(side.ports[k], energy[k], wave[k])
    side.sender = sender


@jit_compile
def update_contact_models(
    settings: BilateralSettings, side: Side, travel: Array, force: Array, axes: int
) -> None:
    """Take over what a new state of the slave says of the tips, for a `render_force` that predicts.

    `travel` [m] and `force` [N] are the estimated ones of the tips, first `axes`.
    """
    if settings.kind != PASSIVITY:
        return
    stiffness_max = settings.passivity.stiffness_max
    for k in range(axes):
        contact.update_contact_model(side.contacts[k], travel[k], force[k], stiffness_max)


@jit_compile
def keep_reserves(settings: BilateralSettings, side: Side) -> None:
    """Keep all ports of an uncoupled side at the reserve."""
    for k in range(MAX_JOINTS):
        energy_ledger.keep_reserve(side.ports[k], settings.reserve)
        contact.reset_prediction(side.contacts[k])


@jit_compile
def count_hand_work(
    settings: BilateralSettings,
    side: Side,
    position: Array,
    velocity: Array,
    written: Array,
    axes: int,
    lever: float,
    coupled: bool,
    dt: float,
) -> None:
    """Add the work of the hand since the last tick: the master's first phase.

    Then `passed_on` and `sent_wave` of the ports go into the next command; `render_force` is the
    second phase. Nothing here depends on the present tip forces.

    Parameters
    ----------
    position, velocity : ndarray
        Position [m] and velocity [m/s] of the hand, shape (MAX_JOINTS,), in tip units; only
        differences of position matter.
    written : ndarray
        Forces rendered since the last tick [N], first `axes`.
    lever : float
        Damping on the device for a damping at the tip: the product of both scales.
    coupled : bool
        Whether forces are rendered.
    dt : float
        Time since the last tick [s].
    """
    if not coupled:
        for k in range(axes):  # fading force
            energy_ledger.count_work(side.ports[k], written[k] * (position[k] - side.requested[k]))
        keep_reserves(settings, side)
    elif not side.coupled:
        keep_reserves(settings, side)
    for k in range(axes):
        hand = side.hand[k]
        hand.written = written[k]
        # the hand's velocity at coupling limits its force
        previous = side.requested[k] if side.coupled else position[k] - velocity[k] * dt
        hand.travel = position[k] - previous
        hand.velocity = velocity[k]
        hand.lever = lever
        hand.dragged = 0.0
        if lever * dt > 0.0:
            # the smaller of two measures, as noise is not damping
            dragged = min(hand.travel * hand.velocity, hand.travel * hand.travel / dt)
            hand.dragged = max(dragged, 0.0) / lever
        if coupled:
            if settings.kind == PASSIVITY:
                passivity.count_hand_work(settings.passivity, side.ports[k], hand)
            elif settings.kind == WAVE:
                wave.count_hand_work(settings.wave, side.ports[k], hand, dt)
            else:
                direct.count_hand_work(side.ports[k], hand)
    for k in range(MAX_JOINTS):
        side.requested[k] = position[k]
        side.tip[k] = position[k]
    side.coupled = coupled
    side.dt = dt


@jit_compile
def render_force(
    settings: BilateralSettings, side: Side, force: Array, axes: int, rendered: Array
) -> None:
    """Compute the forces on the hand: the master's second phase.

    Uses the energy ledger as `count_hand_work` left it, plus what `receive_totals` added since.

    `force` are the received tip forces [N], first `axes`. `rendered`, which may be the same array,
    is overwritten with the forces [N] in tip units, first `axes`; equal to `force` if not coupled.
    """
    for k in range(axes):
        if side.coupled and settings.kind == PASSIVITY:
            config, hand = settings.passivity, side.hand[k]
            predicted = contact.predict_force(
                side.contacts[k],
                force[k],
                side.requested[k],
                hand.velocity,
                config.stiffness_max,
                side.dt,
            )
            rendered[k] = passivity.render_force(config, side.ports[k], hand, predicted, side.dt)
        elif side.coupled and settings.kind == WAVE:
            rendered[k] = wave.render_force(
                settings.wave, side.ports[k], side.hand[k], force[k], side.dt
            )
        elif side.coupled and settings.kind == EXTENSION:
            rendered[k] = side.own_force[k]
        else:
            rendered[k] = force[k]


@jit_compile
def compute_tip_motion(
    settings: BilateralSettings,
    side: Side,
    requested: Array,
    velocity: Array,
    force: Array,
    joints: int,
    coupled: bool,
    dt: float,
    speed_max: float = math.inf,
) -> None:
    """Compute the tip motion [m], [m/s] from the commanded one, in place.

    At the first coupled tick it is the commanded one.

    Parameters
    ----------
    requested, velocity : ndarray
        Commanded motion [m], [m/s], first `joints`; overwritten with the tip motion, unchanged if
        not coupled.
    force : ndarray
        Tip forces [N], first `joints`.
    coupled : bool
        Whether the tips follow.
    dt : float
        Time since the last tick [s].
    speed_max : float
        Largest speed of a tip [m/s]. Commanded motion beyond it is dropped, of all joints by the
        same factor, so that the direction stays and the tips rest when the hand does.
    """
    if not coupled or not side.coupled:
        keep_reserves(settings, side)
        for k in range(joints):
            side.requested[k] = requested[k]
            side.tip[k] = requested[k]
            side.dropped[k] = 0.0
        side.coupled = coupled
        return
    travel_max = speed_max * max(dt, 0.0) if speed_max < math.inf else math.inf
    _drop_excess(side, requested, joints, travel_max)
    for k in range(joints):
        position = side.tip[k]
        previous = side.requested[k]
        wanted, speed = requested[k], velocity[k]
        if settings.kind == EXTENSION:
            wanted, speed = side.own_position[k], side.own_velocity[k]
        speed = min(max(speed, -speed_max), speed_max)
        tip = SlaveInput(force[k], wanted - previous, previous - position, speed, travel_max)
        output = _compute_joint_tip_motion(settings, side.ports[k], tip, dt)
        side.requested[k] = requested[k]
        side.tip[k] = position + output.travel
        requested[k] = side.tip[k]
        velocity[k] = output.velocity


@jit_compile
def _drop_excess(side: Side, requested: Array, joints: int, travel_max: float) -> None:
    """Reduce the commanded travel of this tick to at most `travel_max` [m], in place."""
    largest = 0.0
    for k in range(joints):
        requested[k] -= side.dropped[k]
        largest = max(largest, abs(requested[k] - side.requested[k]))
    if largest > travel_max:
        for k in range(joints):
            excess = (1.0 - travel_max / largest) * (requested[k] - side.requested[k])
            side.dropped[k] += excess
            requested[k] -= excess


@jit_compile
def _compute_joint_tip_motion(
    settings: BilateralSettings, port: Port, tip: SlaveInput, dt: float
) -> SlaveOutput:
    if settings.kind == PASSIVITY:
        return passivity.compute_tip_motion(settings.passivity, port, tip, dt)
    if settings.kind == WAVE:
        return wave.compute_tip_motion(settings.wave, port, tip, dt)
    return direct.compute_tip_motion(port, tip)
