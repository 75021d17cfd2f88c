"""All joints of one side of a coupling: state in, state out."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from teleop.coupling import direct, passivity, wave
from teleop.coupling import port as ledger
from teleop.coupling.config import Bilateral
from teleop.coupling.port import Port
from teleop.coupling.sides import Felt, Followed, Pulled, Rendered
from teleop.messages import MAX_JOINTS, NO_JOINTS, Ledger, padded
from teleop.topics import Role

LEDGER_PERIOD_NS = 10_000_000  # between two messages that tell listeners of the ledger

Numbers = tuple[float, ...]


class Law(NamedTuple):
    """The two steps of a coupling."""

    at_hand: Callable[[Any, Port, Felt, float], Rendered]
    at_tip: Callable[[Any, Port, Pulled, float], Followed]


LAWS: dict[type[Any], Law] = {
    direct.DirectConfig: Law(direct.at_hand, direct.at_tip),
    passivity.PassivityConfig: Law(passivity.at_hand, passivity.at_tip),
    wave.WaveConfig: Law(wave.at_hand, wave.at_tip),
}


class Side(NamedTuple):
    """What one side of a coupling remembers from one tick to the next."""

    ports: tuple[Port, ...] = (Port(),) * MAX_JOINTS
    sender: int = 0  # nonce of the other side
    asked: Numbers = NO_JOINTS  # [m] where the hand (master) asked the tips to be (slave)
    tip: Numbers | None = None  # [m] where they were sent instead; None = not coupled

    @property
    def energy(self) -> Numbers:
        """What is told of energy [J]."""
        return tuple(port.passed_on for port in self.ports)

    @property
    def wave(self) -> Numbers:
        """What is told of waves [sqrt(J s)]."""
        return tuple(port.told_wave for port in self.ports)


def hear(side: Side, sender: int, energy: Sequence[float], wave: Sequence[float]) -> Side:
    """Take in what the other side tells, MAX_JOINTS entries; `sender` is its nonce."""
    ports = side.ports
    if sender != side.sender:
        ports = tuple(map(ledger.forget, ports))
    ports = tuple(map(ledger.hear, ports, energy, wave))
    return side._replace(ports=ports, sender=sender)


def at_hand(
    bilateral: Bilateral,
    side: Side,
    place: Sequence[float],
    velocity: Sequence[float],
    written: Sequence[float],
    force: Sequence[float],
    lever: float,
    coupled: bool,
    dt: float,
) -> tuple[Numbers, Side]:
    """Return the forces that the hand shall feel [N], in tip units, one for each of `force`.

    Parameters
    ----------
    place, velocity : sequences of float
        Where the hand is [m] and goes [m/s], MAX_JOINTS entries, in units of the tip; only how far
        it went counts.
    written : sequence of float
        What was rendered since the last tick [N].
    force : sequence of float
        What the tips feel [N], as told.
    lever : float
        Damping on the device for a damping at the tip: the product of both scales.
    coupled : bool
        Whether forces are rendered; if not, `force` is returned as it is.
    """
    config, asked = bilateral.coupling, tuple(place)
    if not coupled:
        ways = (now - before for now, before in zip(asked, side.asked, strict=True))
        done = (force * way for force, way in zip(written, ways, strict=False))
        worked = map(ledger.worked, side.ports, done)  # by a force that fades
        ports = (*worked, *side.ports[len(written) :])
        ports = tuple(ledger.rest(port, config.reserve) for port in ports)
        return tuple(force), Side(ports, side.sender, asked)
    ports, before = side.ports, side.asked
    if side.tip is None:  # how fast the hand moves already tells what it may be given
        ports = tuple(ledger.rest(port, config.reserve) for port in ports)
        before = tuple(now - speed * dt for now, speed in zip(asked, velocity, strict=True))
    step, rendered = LAWS[type(config)].at_hand, []
    for port, f, was, now, then, speed in zip(
        ports, force, written, asked, before, velocity, strict=False
    ):
        way = now - then
        # by the smaller of two measures: noise in one of them is no damping
        dragged = max(min(way * speed, way * way / dt), 0.0) / lever if lever * dt > 0.0 else 0.0
        rendered.append(step(config, port, Felt(f, was, way, speed, dragged), dt))
    ports = (*(r.port for r in rendered), *ports[len(rendered) :])
    return tuple(r.force for r in rendered), Side(ports, side.sender, asked, asked)


def at_tip(
    bilateral: Bilateral,
    side: Side,
    asked: Sequence[float],
    velocity: Sequence[float],
    force: Sequence[float],
    coupled: bool,
    dt: float,
) -> tuple[Numbers, Numbers, Side]:
    """Return where the tips shall be [m] and go [m/s], one for each of `asked`.

    At the tick at which they are first coupled they shall be where they are asked to be.

    Parameters
    ----------
    asked, velocity : sequences of float
        By the hand [m], [m/s].
    force : sequence of float
        What the tips feel [N].
    coupled : bool
        Whether the tips follow; if not, what is asked is returned as it is.
    """
    config, asked = bilateral.coupling, tuple(asked)
    if not coupled or side.tip is None:
        ports = tuple(ledger.rest(port, config.reserve) for port in side.ports)
        resting = Side(ports, side.sender, asked, asked if coupled else None)
        return asked, tuple(velocity), resting
    step = LAWS[type(config)].at_tip
    followed = [
        step(config, port, Pulled(f, now - before, before - place, speed), dt)
        for port, f, now, before, place, speed in zip(
            side.ports, force, asked, side.asked, side.tip, velocity, strict=False
        )
    ]
    tip = tuple(place + f.way for place, f in zip(side.tip, followed, strict=True))
    ports = (*(f.port for f in followed), *side.ports[len(followed) :])
    speeds = tuple(f.velocity for f in followed)
    return tip, speeds, Side(ports, side.sender, asked, tip)


def ledger_message(role: Role, side: Side, joints: int) -> Ledger:
    """Return what listeners are told about the ledger of one side."""
    ports = side.ports[:joints]

    def column(name: str) -> Numbers:
        return padded([getattr(port, name) for port in ports], MAX_JOINTS)

    return Ledger(
        role=role,
        joints=joints,
        credit=column("credit"),
        put_in=column("put_in"),
        taken_out=column("taken_out"),
        passed_on=column("passed_on"),
        heard=column("heard"),
        dissipated=column("dissipated"),
        granted=column("granted"),
    )
