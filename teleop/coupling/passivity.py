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
- The environment at the slave's port returns no more than it took (`ledger.count_tip_work`), a
constant load no more than `tip_allowance` besides; what the slave does not need goes back to the
master, which needs it for a load that the hand has moved with before the tip has.
"""

import math
from dataclasses import dataclass
from typing import Literal

from estimator.compiled import jit_compile
from teleop.coupling import ledger
from teleop.coupling.interface import MasterInput, SlaveInput, SlaveOutput, limit_travel
from teleop.coupling.ledger import Port


@dataclass(frozen=True, slots=True)
class PassivityConfig:
    """Tolerances of the two passivity controllers; all in tip units."""

    type: Literal["passivity"] = "passivity"
    reserve: float = 0.001  # [J] credit of each port at engagement
    credit_max: float = 0.050  # [J] upper bound of the credit
    spring_stiffness: float = 4.5e3  # [N/m] at the hand, of the spring that holds its credit
    spring_damping: float = 6.0  # [N s/m] at the hand, of that spring
    discharge_time: float = 0.010  # [s] time constant of using up credit
    return_time: float = 0.05  # [s] time constant of giving back the slave's surplus
    tip_allowance: float = 0.020  # [J] that a constant load may return before it has taken any
    stiffness_max: float = 20e3  # [N/m] at the tip, of the predicted contact; 0 = no prediction
    # [m] largest change of the hand's travel per tick; scales with the square above 2.5 ms
    step_tolerance: float = 2e-5
    hand_damping: float = 2.0  # [N s/m] at the device, least damping of a hand
    catch_up: float = 0.050  # [s] time constant of catching up of the tip
    passive_tip: bool = True  # false for an active environment whose force shall be rendered

    def __post_init__(self) -> None:
        """Check the values; raises `ValueError`."""
        if not 0.0 < self.reserve <= 0.1:
            raise ValueError("reserve: must be above 0 and at most 0.1 [J]")
        if not self.reserve <= self.credit_max <= 1.0:
            raise ValueError("credit_max: must be at least reserve and at most 1 [J]")
        if not 10.0 <= self.spring_stiffness <= 1e6:
            raise ValueError("spring_stiffness: must be within 10 ... 1e6 [N/m]")
        if not 0.0 <= self.spring_damping <= 100.0:
            raise ValueError("spring_damping: must be within 0 ... 100 [N s/m]")
        if not 5e-3 <= self.return_time <= 100.0:
            raise ValueError("return_time: must be within 0.005 ... 100 [s]")
        if not 0.0 <= self.tip_allowance <= 0.1:
            raise ValueError("tip_allowance: must be within 0 ... 0.1 [J]")
        if not 0.0 <= self.stiffness_max <= 1e5:
            raise ValueError("stiffness_max: must be within 0 ... 1e5 [N/m]")
        if not 1e-3 <= self.discharge_time <= 0.5:
            raise ValueError("discharge_time: must be within 0.001 ... 0.5 [s]")
        if not 1e-6 <= self.step_tolerance <= 1e-2:
            raise ValueError("step_tolerance: must be within 1e-6 ... 0.01 [m]")
        if not 0.0 <= self.hand_damping <= 100.0:
            raise ValueError("hand_damping: must be within 0 ... 100 [N s/m]")
        if not 5e-3 <= self.catch_up <= 10.0:
            raise ValueError("catch_up: must be within 0.005 ... 10 [s]")


@jit_compile
def count_hand_work(config: PassivityConfig, port: Port, hand: MasterInput) -> None:
    """Add the work of the hand and pass it on; see `teleop.coupling.interface`."""
    work = hand.written * hand.travel
    ledger.count_work(port, work)
    ledger.grant_energy(port, config.hand_damping * hand.dragged)
    ledger.pass_on_energy(port, min(work, port.credit - config.reserve))
    ledger.cap_credit(port, config.credit_max)


@jit_compile
def render_force(
    config: PassivityConfig, port: Port, hand: MasterInput, force: float, dt: float
) -> float:
    """Return `force` [N] limited by the credit; see `teleop.coupling.interface`."""
    if not math.isfinite(force):
        return force
    yielding = -math.copysign(1.0, force)
    margin = ledger.scale_step_tolerance(config.step_tolerance, dt)
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
    travel = ledger.limit_travel_to_credit(port, tip.force, requested, share)
    work = -tip.force * travel
    if config.passive_tip:
        ledger.count_tip_work_under_load(
            port, tip.force, travel, config.tip_allowance, config.credit_max, dt
        )
    else:
        ledger.count_work(port, work)
    ledger.pass_on_energy(port, min(work, port.credit - config.reserve))
    credit_min = config.reserve + max(tip.force * (requested - travel + tip.lag), 0.0)
    ledger.pass_on_energy(port, (port.credit - credit_min) * min(dt / config.return_time, 1.0))
    ledger.cap_credit(port, config.credit_max)
    velocity = tip.velocity * (travel / requested) if requested != 0.0 else tip.velocity
    return SlaveOutput(travel, velocity)
