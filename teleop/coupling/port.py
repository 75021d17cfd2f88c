"""The energy ledger of one port: what went in and out of the network between hand and tip.

Each joint has a port at either side, with a velocity (of the tip asked for, of the tip followed)
and a force (at the tip, attenuated: `teleop.force_attenuation`). Everything is in tip units; the
scales of motion and force are an ideal transformer outside, at the hand. A port that does work on
the network gains credit, one that takes work out uses it up, and credit passes to the other side:

    credit = granted + put in + heard - taken out - passed on - dissipated

Told is how much was ever passed on, not what was passed on last, and heard is the largest that was
ever told. So a message that is lost, repeated or late changes nothing: the next one says all of it.
What the sum over both ports cannot break is then

    taken out of both <= put into both + granted

as long as neither credit falls below zero, whatever the delay (Ryu, Artigas & Preusche 2010; with
stores at both ends Franken et al. 2011).

All functions are compiled and change the port in place.
"""

import math

from estimator.compiled import compiled
from estimator.records import F64, Record

_ABSURD = 1e6  # [J], [sqrt(J s)] a watt for eleven days; NaN is not below it either

_TOLERATED_DT = 0.0025  # [s] at 2e-5 m a tip's 3.2 m/s^2; ticks of 3 ms and more overdrew by mJ


class Port(Record):
    """One joint's port at one side; energies [J] are sums since the process started."""

    credit: F64 = 0.0  # that may be taken out
    put_in: F64 = 0.0  # work done on the network
    taken_out: F64 = 0.0
    passed_on: F64 = 0.0  # to the other side: this is told
    received: F64 = 0.0  # from it, as far as it counted
    dissipated: F64 = 0.0  # given up
    granted: F64 = 0.0  # given at engagements, and for what a hand dissipates by itself
    lent: F64 = 0.0  # [J] what is behind the port has taken out and may bring back
    sent_wave: F64 = 0.0  # [sqrt(J s)] integral of the waves sent; this is told too
    received_energy: F64 = math.nan  # largest that this sender told; NaN: none yet
    received_wave: F64 = 0.0  # [sqrt(J s)] told together with it
    played_wave: F64 = 0.0  # [sqrt(J s)] of it, what has come out


@compiled
def receive(port: Port, energy: float, wave: float) -> None:
    """Take in what the other side has told: sums [J] and [sqrt(J s)] since it started.

    Sums of energy never fall, so the larger one is the newer one, and its wave counts. The first
    that a sender tells is where counting begins. A sum that no session comes to is ignored.
    """
    if not (abs(energy) < _ABSURD and abs(wave) < _ABSURD):
        return
    if math.isnan(port.received_energy):
        port.received_energy = energy
        port.received_wave = wave
        port.played_wave = wave
        return
    more = energy - port.received_energy
    if more <= 0.0:
        return
    port.credit += more
    port.received += more
    port.received_energy = energy
    port.received_wave = wave


@compiled
def forget(port: Port) -> None:
    """Begin to count anew what is heard: the other side was replaced."""
    port.received_energy = math.nan


@compiled
def rest(port: Port, reserve: float) -> None:
    """Keep a port that is not coupled at `reserve` [J], for when it is, and nothing else."""
    surplus = port.credit - reserve
    port.credit = reserve
    port.dissipated += max(surplus, 0.0)
    port.granted += max(-surplus, 0.0)
    port.lent = 0.0
    port.played_wave = port.received_wave


@compiled
def count_work(port: Port, energy: float) -> None:
    """Count `energy` [J] of work done on the network; below zero it was taken out of it."""
    port.credit += energy
    if energy >= 0.0:
        port.put_in += energy
    else:
        port.taken_out -= energy


@compiled
def grant(port: Port, energy: float) -> None:
    """Grant `energy` [J]: what is behind the port is known to dissipate it by itself."""
    port.credit += energy
    port.granted += energy


@compiled
def pass_on(port: Port, energy: float) -> None:
    """Let the other side have `energy` [J] of the credit; nothing if that is below zero."""
    if not energy > 0.0:
        return
    port.credit -= energy
    port.passed_on += energy


@compiled
def cap_credit(port: Port, most: float) -> None:
    """Give up what credit there is above `most` [J]."""
    surplus = port.credit - most
    if surplus <= 0.0:
        return
    port.credit = most
    port.dissipated += surplus


@compiled
def count_tip_work(port: Port, energy: float, passive: bool) -> None:
    """Count work of what is behind the slave's port; see `count_work`.

    What is `passive` brings back no more than it took: the rest of what it does is given up. A
    servo that lags behind would otherwise make an active spring of every tissue.
    """
    count_work(port, energy)
    if energy < 0.0:
        port.lent -= energy
        return
    surplus = max(energy - port.lent, 0.0) if passive else 0.0
    port.credit -= surplus
    port.dissipated += surplus
    port.lent = max(port.lent - energy, 0.0)


@compiled
def jerk_margin(step_tolerance: float, dt: float) -> float:
    """Return the `step_tolerance` [m] of a tick of `dt` [s].

    What a hand travels more than in the tick before grows with the square of the tick. The setting
    is for ticks of up to `_TOLERATED_DT`.
    """
    longer = max(dt / _TOLERATED_DT, 1.0)
    return step_tolerance * longer * longer


@compiled
def affordable_force(
    port: Port, force: float, travel: float, ticks: float, step_tolerance: float
) -> float:
    """Return `force` [N] as far as the credit lasts, however the hand yields to it.

    A hand that travelled `travel` [m] in the last tick goes at least `travel - step_tolerance` and
    at most `travel + step_tolerance` in the next. Where it yields, as it did, by
    y = -travel sign(force),

        |force| <= credit / (ticks max(y, 0) + step_tolerance + min(y, 0))

    so the credit falls exponentially, over so many `ticks`, and not below zero. A hand that presses
    by more than `step_tolerance` cannot yield in the next tick: it may be given any force, whatever
    the credit is.
    """
    yielding = -math.copysign(1.0, force) * travel
    worst = ticks * max(yielding, 0.0) + step_tolerance + min(yielding, 0.0)
    if worst <= 0.0:
        return force
    most = max(port.credit, 0.0) / worst
    return min(max(force, -most), most)


@compiled
def affordable_travel(port: Port, force: float, travel: float, share: float) -> float:
    """Return how far [m] of `travel` the tip may go against `force` [N] on a `share` of the credit.

    With the force it may always go.
    """
    if force * travel <= 0.0:
        return travel
    most = share * max(port.credit, 0.0) / abs(force)
    return math.copysign(min(abs(travel), most), travel)
