"""Time-domain passivity control of both ports.

A passivity observer at each port integrates the energy that leaves it, and a passivity controller
keeps that below the received energy put in at the other port (Ryu, Artigas & Preusche, "A passive
bilateral control scheme for a teleoperator with time-varying communication delay", Mechatronics 20,
2010, 812-823). The slave's controller limits the motion: the tip moves against a force as far as
the credit lasts, and catches up when more is received. The master's limits the force.

Six differences:

- A hand is a damper too, and the energy it certainly dissipates is granted. So a wall pushes it
back with its full force, although the servo's lag makes that slightly active.
- Each side keeps `reserve` of the work done at its own port and passes on the rest, as the stores
  of Franken et al., "Bilateral telemanipulation with time delays: a two-layer approach combining
  passivity and transparency", IEEE Trans. Robotics 27, 2011, 741-756. A hand that trembles against
  a wall then uses its own energy.
- The force is that of a spring which holds the credit, |f| <= sqrt(2 k credit) with k of
`spring_stiffness` at the hand, damped: soft enough for the sampled device, so a force that is
limited does not buzz. A bound by the hand's last step buzzes with every step of an encoder. The
slave's credit is used up over a time.
- The force is predicted by a local stiffness (`teleop.coupling.contact`), so that delay and the lag
of the tip's motor need no dissipation that the controller would have to find.
- The environment at the slave's port returns no more than it took (`energy_ledger.count_tip_work`),
a constant load no more than `tip_allowance` besides; what the slave does not need goes back to the
master, which needs it for a load that the hand has moved with before the tip has.
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
class PassivityConfig:
    """Tolerances of the two passivity controllers; all in tip units."""

    type: Literal["passivity"] = "passivity"
    # credit of each port at engagement
    reserve: float = build_ranged_field(0.001, 0.0, 0.1, "J", above=True)
    credit_max: float = 0.050  # [J] upper bound of the credit
    # at the hand, of the spring that holds its credit
    spring_stiffness: float = build_ranged_field(4.5e3, 10.0, 1e6, "N/m")
    # at the hand, of that spring
    spring_damping: float = build_ranged_field(6.0, 0.0, 100.0, "N s/m")
    # time constant of using up credit
    discharge_time: float = build_ranged_field(0.010, 1e-3, 0.5, "s")
    # time constant of giving back the slave's surplus
    return_time: float = build_ranged_field(0.05, 5e-3, 100.0, "s")
    # that a constant load may return before it has taken any
    tip_allowance: float = build_ranged_field(0.020, 0.0, 0.1, "J")
    # at the tip, of the predicted contact; 0 = no prediction
    stiffness_max: float = build_ranged_field(20e3, 0.0, 1e5, "N/m")
    # largest change of the hand's travel per tick; scales with the square above 2.5 ms
    step_tolerance: float = build_ranged_field(2e-5, 1e-6, 1e-2, "m")
    # at the device, least damping of a hand
    hand_damping: float = build_ranged_field(2.0, 0.0, 100.0, "N s/m")
    # time constant of catching up of the tip
    catch_up: float = build_ranged_field(0.050, 5e-3, 10.0, "s")
    passive_tip: bool = True  # false for an active environment whose force shall be rendered

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.reserve <= self.credit_max <= 1.0:
            raise ValueError("credit_max: must be at least reserve and at most 1 [J]")


@jit_compile
def count_hand_work(config: PassivityConfig, port: Port, hand: MasterInput) -> None:
    """Add the work of the hand and pass it on; see `teleop.coupling.interface`."""
    work = hand.written * hand.travel
    energy_ledger.count_work(port, work)
    energy_ledger.grant_energy(port, config.hand_damping * hand.dragged)
    energy_ledger.pass_on_energy(port, min(work, port.credit - config.reserve))
    energy_ledger.cap_credit(port, config.credit_max)


@jit_compile
def render_force(
    config: PassivityConfig, port: Port, hand: MasterInput, force: float, dt: float
) -> float:
    """Return `force` [N] limited by the credit; see `teleop.coupling.interface`."""
    if not math.isfinite(force):
        return force
    yielding = -math.copysign(1.0, force)
    margin = energy_ledger.scale_step_tolerance(config.step_tolerance, dt)
    next_path = yielding * hand.travel + margin  # [m] that the hand may yield in the next tick
    if port.credit <= 0.0 and next_path <= 0.0:
        return force  # that hand makes good what was overdrawn
    credit = max(port.credit, 0.0)
    path = max(yielding * hand.velocity * config.discharge_time, next_path, 1e-9)
    force_max = credit / path
    if hand.lever > 0.0:
        spring = math.sqrt(2.0 * config.spring_stiffness / hand.lever * credit)
        spring -= config.spring_damping / hand.lever * yielding * hand.velocity
        force_max = min(force_max, max(spring, 0.0))
    return min(max(force, -force_max), force_max)


@jit_compile
def compute_tip_motion(
    config: PassivityConfig, port: Port, tip: SlaveInput, dt: float
) -> SlaveOutput:
    """Return the motion limited by the credit; see `teleop.coupling.interface`."""
    requested = limit_travel(tip, tip.travel + tip.lag * min(dt / config.catch_up, 1.0))
    share = min(dt / config.discharge_time, 1.0)
    travel = energy_ledger.limit_travel_to_credit(port, tip.force, requested, share)
    work = -tip.force * travel
    if config.passive_tip:
        energy_ledger.count_tip_work_under_load(
            port, tip.force, travel, config.tip_allowance, config.credit_max, dt
        )
    else:
        energy_ledger.count_work(port, work)
    energy_ledger.pass_on_energy(port, min(work, port.credit - config.reserve))
    credit_min = config.reserve + max(tip.force * (requested - travel + tip.lag), 0.0)
    energy_ledger.pass_on_energy(
        port, (port.credit - credit_min) * min(dt / config.return_time, 1.0)
    )
    energy_ledger.cap_credit(port, config.credit_max)
    velocity = tip.velocity * (travel / requested) if requested != 0.0 else tip.velocity
    return SlaveOutput(travel, velocity)
