"""Wave variables: what travels is not motion and force, but their wave.

    u = (b v + f) / sqrt(2 b)  to the tip,      w = (b v - f) / sqrt(2 b)  to the hand

carry the power u^2 / 2 and w^2 / 2, so that a delay only stores energy (Niemeyer & Slotine, "Stable
adaptive teleoperation", IEEE J. Oceanic Eng. 16, 1991, 152-162). The hand feels

    f = b v - sqrt(2 b) w,      and the tip goes at      v = (sqrt(2 b) u - f) / b

Told are the integral of the wave and its energy (Niemeyer & Slotine, "Telemanipulation with time
delays", Int. J. Robotics Research 23, 2004, 873-890): the receiver plays the integral it has not
played yet, over a time, and never with more energy than has come. Loss and jitter then cost time,
not position. Each port keeps the same ledger as every coupling: no wave is sent, and no work done,
without credit.
"""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

from teleop.coupling import port as ledger
from teleop.coupling.port import Port
from teleop.coupling.sides import Felt, Followed, Pulled, Rendered


@dataclass(frozen=True, slots=True)
class WaveConfig:
    """The impedance, and how waves are played; all in tip units."""

    type: Literal["wave"] = "wave"
    impedance: float = 100.0  # [N s/m] b: the drag felt in free motion, and how soon a wall is
    play: float = 0.020  # [s] over which a wave that has come is played; twice the jitter
    reserve: float = 0.002  # [J] credit of each port at engagement
    credit_max: float = 0.020  # [J] credit above it is given up
    give: float = 2e-5  # [m] that a hand may move in a tick more than in the one before
    catch_up: float = 2.0  # [s] in which the tip comes after where waves have left it behind
    passive_tip: bool = True  # false where what the tip touches moves by itself, and shall be felt

    def __post_init__(self) -> None:
        """Refuse a line that carries nothing."""
        if not 0.1 <= self.impedance <= 1e4:
            raise ValueError("impedance: must be within 0.1 ... 10000 [N s/m]")
        if not 1e-3 <= self.play <= 0.5:
            raise ValueError("play: must be within 0.001 ... 0.5 [s]")
        if not 0.0 < self.reserve <= 0.1:
            raise ValueError("reserve: must be above 0 and at most 0.1 [J]")
        if not self.reserve <= self.credit_max <= 1.0:
            raise ValueError("credit_max: must be at least reserve and at most 1 [J]")
        if not 1e-6 <= self.give <= 1e-2:
            raise ValueError("give: must be within 1e-6 ... 0.01 [m]")
        if not 5e-3 <= self.catch_up <= 10.0:
            raise ValueError("catch_up: must be within 0.005 ... 10 [s]")


class Played(NamedTuple):
    """The wave that comes out of the line now."""

    wave: float  # [sqrt(W)]
    port: Port


def play(config: WaveConfig, port: Port, dt: float) -> Played:
    """Play what has come of the other side's wave, with no more energy than there is credit.

    Of a rest U of the integral, with energy E to go with it, goes out

        min(|U| / play, 2 E / |U|)

    The second is the one constant wave that has both; so waves that came in lumps go out even.
    """
    rest = port.heard_wave - port.played_wave
    if rest == 0.0:
        return Played(0.0, port)
    most = 2.0 * max(port.credit, 0.0) / abs(rest)
    wave = math.copysign(min(abs(rest) / max(config.play, dt), most), rest)
    return Played(wave, port._replace(played_wave=port.played_wave + wave * dt))


def send(config: WaveConfig, port: Port, wave: float, dt: float) -> Port:
    """Send `wave` [sqrt(W)] as far as there is credit for it."""
    most = math.sqrt(2.0 * max(port.credit, 0.0) / dt)
    wave = min(max(wave, -most), most)
    port = ledger.pass_on(port, min(0.5 * wave * wave * dt, port.credit))
    port = port._replace(told_wave=port.told_wave + wave * dt)
    return ledger.capped(port, config.credit_max)


def at_hand(config: WaveConfig, port: Port, felt: Felt, dt: float) -> Rendered:
    """Return the force of the wave that came back; see `teleop.coupling.sides`."""
    if not math.isfinite(felt.force) or dt <= 0.0:
        return Rendered(felt.force, port)
    b = config.impedance
    port = ledger.worked(port, felt.written * felt.way)
    port = send(config, port, (b * felt.way / dt + felt.written) / math.sqrt(2.0 * b), dt)
    came, port = play(config, port, dt)
    force = b * felt.velocity - math.sqrt(2.0 * b) * came
    return Rendered(ledger.affordable(port, force, felt.way, 1.0, config.give), port)


def at_tip(config: WaveConfig, port: Port, pulled: Pulled, dt: float) -> Followed:
    """Return the motion that the wave makes against the force; see `teleop.coupling.sides`."""
    if dt <= 0.0:
        return Followed(0.0, 0.0, port)
    b = config.impedance
    came, port = play(config, port, dt)
    wanted = (math.sqrt(2.0 * b) * came - pulled.force) / b * dt
    used = abs(came * (port.heard_wave - port.played_wave))  # by the wave that is under way
    spare = min(max((port.credit - used) / config.reserve - 1.0, 0.0), 1.0)
    wanted += (pulled.way + pulled.lag) * min(spare * dt / config.catch_up, 1.0)
    way = ledger.affordable_way(port, pulled.force, wanted, 1.0)
    port = ledger.returned(port, -pulled.force * way, config.passive_tip)
    back = (b * way / dt - pulled.force) / math.sqrt(2.0 * b)
    return Followed(way, way / dt, send(config, port, back, dt))
