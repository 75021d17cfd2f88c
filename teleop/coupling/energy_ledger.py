"""The energy ledger of one port of the network between hand and tip.

Each joint has a port at either side, with a velocity (of the tip, commanded and followed) and a
force (at the tip, attenuated: `force_attenuation`). Everything is in tip units; the scales
of motion and force are an ideal transformer outside, at the hand. Work done on the network adds
credit, work taken out uses it, and credit is passed to the other side:

    credit = granted + put in + received - taken out - passed on - dissipated

Messages carry the total passed on, and the receiver uses the largest total, so lost, repeated or
late messages have no effect on the balance. The sum over both ports satisfies

    taken out of both <= put into both + granted

as long as neither credit falls below zero, whatever the delay (Ryu, Artigas & Preusche 2010; with
stores at both ends Franken et al. 2011).

All functions are compiled and change the port in place.
"""

import math
from typing import Any

from estimator.compiled import jit_compile
from estimator.structs import F64, Struct, StructArray
from teleop.messages.messages import Ledger
from teleop.messages.packet import Packet
from teleop.messages.topics import Role

_TOTAL_MAX = 1e6  # [J], [sqrt(J s)] a watt for eleven days; NaN fails the comparison too

LOAD_TIME_CONSTANT_S = 1.0  # [s] over which a force is a constant load

# [s] at 2e-5 m a tip's 3.2 m/s^2; the credit was overdrawn by mJ with ticks of 3 ms
_STEP_TOLERANCE_DT_MAX = 0.0025


class Port(Struct):
    """One joint's port at one side; energies [J] are sums since the process started."""

    credit: F64 = 0.0  # available energy
    put_in: F64 = 0.0  # work done on the network
    taken_out: F64 = 0.0
    passed_on: F64 = 0.0  # to the other side; sent in messages
    received: F64 = 0.0  # from the other side, as far as credited
    dissipated: F64 = 0.0  # given up
    granted: F64 = 0.0  # at engagements, and for the dissipation of the hand
    lent: F64 = 0.0  # [J] taken out by the environment, which may return it
    load: F64 = math.nan  # [N] constant part of the tip's force; NaN: not known yet
    returned: F64 = 0.0  # [J] by that load, less what it took
    sent_wave: F64 = 0.0  # [sqrt(J s)] integral of the waves sent; sent in messages
    received_energy: F64 = math.nan  # largest total of this sender; NaN: none yet
    received_wave: F64 = 0.0  # [sqrt(J s)] received with it
    played_wave: F64 = 0.0  # [sqrt(J s)] part of it already played


@jit_compile
def receive_totals(port: Port, energy: float, wave: float) -> None:
    """Process the totals of the other side: [J] and [sqrt(J s)] since it started.

    Energy totals never decrease, so a larger one is newer, and its wave is used. The first total of
    a sender is the reference. Implausible totals are ignored.
    """
    if not (abs(energy) < _TOTAL_MAX and abs(wave) < _TOTAL_MAX):
        return
    if math.isnan(port.received_energy):
        port.received_energy = energy
        port.received_wave = wave
        port.played_wave = wave
        return
    increase = energy - port.received_energy
    if increase <= 0.0:
        return
    port.credit += increase
    port.received += increase
    port.received_energy = energy
    port.received_wave = wave


@jit_compile
def reset_received_totals(port: Port) -> None:
    """Reset the reference of received totals: the other side was replaced."""
    port.received_energy = math.nan


@jit_compile
def keep_reserve(port: Port, reserve: float) -> None:
    """Keep the credit of an uncoupled port at `reserve` [J]."""
    surplus = port.credit - reserve
    port.credit = reserve
    port.dissipated += max(surplus, 0.0)
    port.granted += max(-surplus, 0.0)
    port.lent = port.returned = 0.0
    port.load = math.nan
    port.played_wave = port.received_wave


@jit_compile
def count_work(port: Port, energy: float) -> None:
    """Add `energy` [J] of work done on the network; negative if taken out."""
    port.credit += energy
    if energy >= 0.0:
        port.put_in += energy
    else:
        port.taken_out -= energy


@jit_compile
def grant_energy(port: Port, energy: float) -> None:
    """Grant `energy` [J] that the hand is known to dissipate."""
    port.credit += energy
    port.granted += energy


@jit_compile
def pass_on_energy(port: Port, energy: float) -> None:
    """Pass `energy` [J] of the credit to the other side, if positive."""
    if not energy > 0.0:
        return
    port.credit -= energy
    port.passed_on += energy


@jit_compile
def cap_credit(port: Port, credit_max: float) -> None:
    """Dissipate credit above `credit_max` [J]."""
    surplus = port.credit - credit_max
    if surplus <= 0.0:
        return
    port.credit = credit_max
    port.dissipated += surplus


@jit_compile
def count_tip_work(port: Port, energy: float, passive: bool) -> None:
    """Add work of the environment at the slave's port; see `count_work`.

    A `passive` environment returns no more than it took; the rest is dissipated. The lag of the
    servo would otherwise make any tissue an active spring.
    """
    count_work(port, energy)
    if energy < 0.0:
        port.lent -= energy
        return
    surplus = _repay_lent_energy(port, energy) if passive else 0.0
    port.credit -= surplus
    port.dissipated += surplus


@jit_compile
def _repay_lent_energy(port: Port, energy: float) -> float:
    """Return how much of `energy` [J], positive, the environment was not lent."""
    surplus = max(energy - port.lent, 0.0)
    port.lent = max(port.lent - energy, 0.0)
    return surplus


@jit_compile
def count_tip_work_under_load(
    port: Port, force: float, travel: float, allowance: float, credit_max: float, dt: float
) -> None:
    """Add the work of a passive environment, as `count_tip_work` does, but for a constant load.

    A weight or a stretched spring has energy before it is moved, and may return up to `allowance`
    [J] more than it took, of which up to `credit_max` [J] are remembered. Its part of the tip's
    `force` [N] is what that has been over `LOAD_TIME_CONSTANT_S`.
    """
    if math.isnan(port.load):
        port.load = force
    port.load += (force - port.load) * min(dt / LOAD_TIME_CONSTANT_S, 1.0)
    count_work(port, -force * travel)
    of_load, of_rest = -port.load * travel, -(force - port.load) * travel
    port.returned = max(port.returned + of_load, -credit_max)
    surplus = max(port.returned - allowance, 0.0)
    port.returned -= surplus
    surplus += _repay_lent_energy(port, of_rest)
    surplus = min(surplus, max(port.credit, 0.0))
    port.credit -= surplus
    port.dissipated += surplus


@jit_compile
def scale_step_tolerance(step_tolerance: float, dt: float) -> float:
    """Return the `step_tolerance` [m] of a tick of `dt` [s].

    The change of a hand's travel per tick grows with the square of the tick. The setting
    is for ticks of up to `_STEP_TOLERANCE_DT_MAX`.
    """
    ratio = max(dt / _STEP_TOLERANCE_DT_MAX, 1.0)
    return step_tolerance * ratio * ratio


@jit_compile
def limit_force_to_credit(
    port: Port, force: float, travel: float, ticks: float, step_tolerance: float
) -> float:
    """Return `force` [N] limited such that the credit lasts for any motion of the hand.

    A hand that travelled `travel` [m] in the last tick goes at least `travel - step_tolerance` and
    at most `travel + step_tolerance` in the next. Where it yields, as it did, by
    y = -travel sign(force),

        |force| <= credit / (ticks max(y, 0) + step_tolerance + min(y, 0))

    so the credit decays exponentially over `ticks`, not below zero. A hand that presses by more
    than `step_tolerance` cannot yield in the next tick: the force is not limited.
    """
    yielding = -math.copysign(1.0, force) * travel
    yield_max = ticks * max(yielding, 0.0) + step_tolerance + min(yielding, 0.0)
    if yield_max <= 0.0:
        return force
    force_max = max(port.credit, 0.0) / yield_max
    return min(max(force, -force_max), force_max)


@jit_compile
def limit_travel_to_credit(port: Port, force: float, travel: float, share: float) -> float:
    """Return how far [m] of `travel` the tip may go against `force` [N] on a `share` of the credit.

    Motion along the force is not limited.
    """
    if force * travel <= 0.0:
        return travel
    travel_max = share * max(port.credit, 0.0) / abs(force)
    return math.copysign(min(abs(travel), travel_max), travel)


# --- publisher of the energy ledger of one side

LEDGER_PERIOD_NS = 10_000_000  # between two messages
_FIELDS = ("credit", "put_in", "taken_out", "passed_on", "received", "dissipated", "granted")


class LedgerPublisher:
    """Fills in the message about the ledger of one side, every `LEDGER_PERIOD_NS`.

    `sides` are the `Side` of a loop, shape (1,), of which `joints` ports are in use.
    """

    def __init__(self, role: Role, sides: StructArray, joints: int) -> None:
        self._packet = Packet(Ledger)
        self._fields: Any = self._packet.records
        self._fields["role"], self._fields["joints"] = role, joints
        self._ports, self._joints = sides["ports"], joints
        self._due_ns = 0

    def is_due(self, stamp_ns: int) -> bool:
        """Return whether a message is due at `stamp_ns` [ns]; the next is then a period later."""
        if stamp_ns < self._due_ns:
            return False
        self._due_ns = stamp_ns + LEDGER_PERIOD_NS
        return True

    def fill(self) -> Packet[Ledger]:
        """Return the message with the present ledger."""
        for name in _FIELDS:
            self._fields[name][:, : self._joints] = self._ports[name][:, : self._joints]
        return self._packet
