"""The energy ledger of one port: what went in and out of the network between hand and tip.

Each joint has a port at either side, with a velocity (of the tip asked for, of the tip followed)
and a force (at the tip, as it is felt: `teleop.confidence`). Everything is in tip units; the scales
of motion and force are an ideal transformer outside, at the hand. A port that does work on the
network gains credit, one that takes work out spends it, and credit passes to the other side:

    credit = granted + put in + heard - taken out - passed on - dissipated

Told is how much was ever passed on, not what was passed on last, and heard is the largest that was
ever told. So a message that is lost, repeated or late changes nothing: the next one says all of it.
What the sum over both ports cannot break is then

    taken out of both <= put into both + granted

as long as neither credit falls below zero, whatever the delay (Ryu, Artigas & Preusche 2010; with
stores at both ends Franken et al. 2011).
"""

import math
from typing import NamedTuple

_ABSURD = 1e6  # [J], [sqrt(J s)] a watt for eleven days; NaN is not below it either


class Port(NamedTuple):
    """One joint's port at one side; energies [J] are sums since the process started."""

    credit: float = 0.0  # that may be taken out
    put_in: float = 0.0  # work done on the network
    taken_out: float = 0.0
    passed_on: float = 0.0  # to the other side: this is told
    heard: float = 0.0  # from it, as far as it counted
    dissipated: float = 0.0  # given up
    granted: float = 0.0  # given at engagements, and for what a hand dissipates by itself
    lent: float = 0.0  # [J] what is behind the port has taken out and may bring back
    told_wave: float = 0.0  # [sqrt(J s)] integral of the waves sent; this is told too
    heard_energy: float = math.nan  # largest that this sender told; NaN: none yet
    heard_wave: float = 0.0  # [sqrt(J s)] told together with it
    played_wave: float = 0.0  # [sqrt(J s)] of it, what has come out


def hear(port: Port, energy: float, wave: float) -> Port:
    """Take in what the other side has told: sums [J] and [sqrt(J s)] since it started.

    Sums of energy never fall, so the larger one is the newer one, and its wave counts. The first
    that a sender tells is where counting begins. A sum that no session comes to is not believed.
    """
    if not (abs(energy) < _ABSURD and abs(wave) < _ABSURD):
        return port
    if math.isnan(port.heard_energy):
        return port._replace(heard_energy=energy, heard_wave=wave, played_wave=wave)
    more = energy - port.heard_energy
    if more <= 0.0:
        return port
    return port._replace(
        credit=port.credit + more,
        heard=port.heard + more,
        heard_energy=energy,
        heard_wave=wave,
    )


def forget(port: Port) -> Port:
    """Begin to count anew what is heard: the other side was replaced."""
    return port._replace(heard_energy=math.nan)


def rest(port: Port, reserve: float) -> Port:
    """Return a port that is not coupled: with `reserve` [J] for when it is, and nothing else."""
    surplus = port.credit - reserve
    return port._replace(
        credit=reserve,
        dissipated=port.dissipated + max(surplus, 0.0),
        granted=port.granted + max(-surplus, 0.0),
        lent=0.0,
        played_wave=port.heard_wave,
    )


def worked(port: Port, energy: float) -> Port:
    """Count `energy` [J] of work done on the network; below zero it was taken out of it."""
    if energy >= 0.0:
        return port._replace(credit=port.credit + energy, put_in=port.put_in + energy)
    return port._replace(credit=port.credit + energy, taken_out=port.taken_out - energy)


def allow(port: Port, energy: float) -> Port:
    """Grant `energy` [J]: what is behind the port is known to dissipate it by itself."""
    return port._replace(credit=port.credit + energy, granted=port.granted + energy)


def pass_on(port: Port, energy: float) -> Port:
    """Let the other side have `energy` [J] of the credit; nothing if that is below zero."""
    if not energy > 0.0:
        return port
    return port._replace(credit=port.credit - energy, passed_on=port.passed_on + energy)


def capped(port: Port, most: float) -> Port:
    """Give up what credit there is above `most` [J]."""
    surplus = port.credit - most
    if surplus <= 0.0:
        return port
    return port._replace(credit=most, dissipated=port.dissipated + surplus)


def returned(port: Port, energy: float, passive: bool) -> Port:
    """Count work of what is behind the slave's port; see `worked`.

    What is `passive` brings back no more than it took: the rest of what it does is given up. A
    servo that lags behind would otherwise make an active spring of every tissue.
    """
    port = worked(port, energy)
    if energy < 0.0:
        return port._replace(lent=port.lent - energy)
    surplus = max(energy - port.lent, 0.0) if passive else 0.0
    return port._replace(
        credit=port.credit - surplus,
        dissipated=port.dissipated + surplus,
        lent=max(port.lent - energy, 0.0),
    )


def affordable(port: Port, force: float, way: float, ticks: float, give: float) -> float:
    """Return `force` [N] as far as the credit lasts, however the hand yields to it.

    A hand that went `way` [m] in the last tick goes at least `way - give` and at most `way + give`
    in the next. Where it yields, as it did, by y = -way sign(force),

        |force| <= credit / (ticks max(y, 0) + give + min(y, 0))

    so the credit falls exponentially, over so many `ticks`, and not below zero. A hand that presses
    by more than `give` cannot yield in the next tick: it may be given any force, whatever the
    credit is.
    """
    yielding = -math.copysign(1.0, force) * way
    worst = ticks * max(yielding, 0.0) + give + min(yielding, 0.0)
    if worst <= 0.0:
        return force
    most = max(port.credit, 0.0) / worst
    return min(max(force, -most), most)


def affordable_way(port: Port, force: float, way: float, share: float) -> float:
    """Return how far [m] of `way` the tip may go against `force` [N] on a `share` of the credit.

    With the force it may always go.
    """
    if force * way <= 0.0:
        return way
    most = share * max(port.credit, 0.0) / abs(force)
    return math.copysign(min(abs(way), most), way)
