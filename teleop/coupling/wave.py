"""Wave variables: the network transmits waves instead of motion and force.

    u = (b v + f) / sqrt(2 b)  to the tip,      w = (b v - f) / sqrt(2 b)  to the hand

carry the power u^2 / 2 and w^2 / 2, so a delay only stores energy (Niemeyer & Slotine, "Stable
adaptive teleoperation", IEEE J. Oceanic Eng. 16, 1991, 152-162). The force on the hand is f = b v -
sqrt(2 b) w, the velocity of the tip      v = (sqrt(2 b) u - f) / b

Messages carry the integral of the wave and its energy (Niemeyer & Slotine, "Telemanipulation with
time delays", Int. J. Robotics Research 23, 2004, 873-890): the receiver plays the rest of the
integral over a time constant, never with more energy than received. Loss and jitter then delay, but
cause no position drift. Each port keeps the same ledger as every coupling: no wave is sent, and no
work done, without credit.
"""

import math
from dataclasses import dataclass
from typing import Literal

from estimator.compiled import jit_compile
from teleop.config.ranges import build_ranged_field, check_ranges
from teleop.coupling import energy_ledger
from teleop.coupling.energy_ledger import Port
from teleop.coupling.interface import MasterInput, SlaveInput, SlaveOutput, limit_travel


@dataclass(frozen=True, slots=True)
class WaveConfig:
    """Wave impedance and playback; all in tip units."""

    type: Literal["wave"] = "wave"
    # b: drag in free motion against delay at a wall
    impedance: float = build_ranged_field(100.0, 0.1, 1e4, "N s/m")
    # playback time of a received wave; twice the jitter
    play: float = build_ranged_field(0.020, 1e-3, 0.5, "s")
    # credit of each port at engagement
    reserve: float = build_ranged_field(0.002, 0.0, 0.1, "J", above=True)
    credit_max: float = 0.020  # [J] upper bound of the credit
    # largest change of the hand's travel per tick; scales with the square above 2.5 ms
    step_tolerance: float = build_ranged_field(2e-5, 1e-6, 1e-2, "m")
    # time constant of the tip's position correction
    catch_up: float = build_ranged_field(2.0, 5e-3, 10.0, "s")
    passive_tip: bool = True  # false for an active environment whose force shall be rendered

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.reserve <= self.credit_max <= 1.0:
            raise ValueError("credit_max: must be at least reserve and at most 1 [J]")


@jit_compile
def reconstruct_wave(config: WaveConfig, port: Port, dt: float) -> float:
    """Return the wave [sqrt(W)] of the other side, with no more energy than the credit.

    With the rest U of the integral and its energy E the output is

        min(|U| / play, 2 E / |U|)

    The second is the constant wave with this integral and energy, so bursts are smoothed.
    """
    rest = port.received_wave - port.played_wave
    if rest == 0.0:
        return 0.0
    wave_max = 2.0 * max(port.credit, 0.0) / abs(rest)
    wave = math.copysign(min(abs(rest) / max(config.play, dt), wave_max), rest)
    port.played_wave += wave * dt
    return wave


@jit_compile
def send_wave(config: WaveConfig, port: Port, wave: float, dt: float) -> None:
    """Send `wave` [sqrt(W)] limited by the credit."""
    wave_max = math.sqrt(2.0 * max(port.credit, 0.0) / dt)
    wave = min(max(wave, -wave_max), wave_max)
    energy_ledger.pass_on_energy(port, min(0.5 * wave * wave * dt, port.credit))
    port.sent_wave += wave * dt
    energy_ledger.cap_credit(port, config.credit_max)


@jit_compile
def count_hand_work(config: WaveConfig, port: Port, hand: MasterInput, dt: float) -> None:
    """Add the work of the hand and send its wave; see `teleop.coupling.interface`."""
    if dt <= 0.0:
        return
    b = config.impedance
    energy_ledger.count_work(port, hand.written * hand.travel)
    wave = (b * hand.travel / dt + hand.written) / math.sqrt(2.0 * b)
    send_wave(config, port, wave, dt)


@jit_compile
def render_force(
    config: WaveConfig, port: Port, hand: MasterInput, force: float, dt: float
) -> float:
    """Return the force [N] of the wave that came back; see `teleop.coupling.interface`.

    The received `force` [N] is already contained in that wave; if not finite, it is returned.
    """
    if not math.isfinite(force) or dt <= 0.0:
        return force
    b = config.impedance
    returned_wave = reconstruct_wave(config, port, dt)
    rendered = b * hand.velocity - math.sqrt(2.0 * b) * returned_wave
    margin = energy_ledger.scale_step_tolerance(config.step_tolerance, dt)
    return energy_ledger.limit_force_to_credit(port, rendered, hand.travel, 1.0, margin)


@jit_compile
def compute_tip_motion(config: WaveConfig, port: Port, tip: SlaveInput, dt: float) -> SlaveOutput:
    """Return the tip motion from wave and force; see `teleop.coupling.interface`."""
    if dt <= 0.0:
        return SlaveOutput(0.0, 0.0)
    b = config.impedance
    returned_wave = reconstruct_wave(config, port, dt)
    requested = (math.sqrt(2.0 * b) * returned_wave - tip.force) / b * dt
    # by the wave being reconstructed
    used = abs(returned_wave * (port.received_wave - port.played_wave))
    spare = min(max((port.credit - used) / config.reserve - 1.0, 0.0), 1.0)
    requested += (tip.travel + tip.lag) * min(spare * dt / config.catch_up, 1.0)
    requested = limit_travel(tip, requested)
    travel = energy_ledger.limit_travel_to_credit(port, tip.force, requested, 1.0)
    energy_ledger.count_tip_work(port, -tip.force * travel, config.passive_tip)
    returned = (b * travel / dt - tip.force) / math.sqrt(2.0 * b)
    send_wave(config, port, returned, dt)
    return SlaveOutput(travel, travel / dt)
