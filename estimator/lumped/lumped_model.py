"""The transmission with everything that real ones add to the paper's law, on nodes of bend angle.

`law.transmission` has the law in closed form; what is here has none: friction that depends on
speed, tension, time or direction, elasticity that is not linear or takes time, and a tip tied to
something. The tendon is a row of springs with contacts between them, evenly spread over the bend
angle. In a step each contact sticks or slides, and by how far is solved for all of them together,
implicit in time (docs/explanation/theory.md (T1), section 8); contacts that give before they slide
are solved from the tip to the housing. At its neutral values `Physics` is that law.
"""

import math
from copy import copy
from typing import NamedTuple, Self

import numpy as np

from estimator.array_types import Array
from estimator.compiled import jit_borrow, jit_compile, jit_inline
from estimator.lumped.nodes import (
    NODES,
    PLACES,
    FrictionLaw,
    Tendon,
    Tip,
    age_contacts,
    compute_elongation,
    compute_tip_travel,
    fill_contacts,
)
from estimator.lumped.play_spectrum import ONE_PLAY, distribute_spectrum
from estimator.lumped.presliding_solver import solve_presliding
from estimator.lumped.stick_slip_solver import KNOWN, WORK_ROWS, solve_stick_slip
from estimator.small_arrays import copy_values

_SUBSTEP_MIN = 1.0 / 8.0  # of a step
_APPROACH = 12  # steps from each of the turns before the first sample to the next
_SUBSTEP_MAX = 0.5  # of a sample: contacts that let go as they slide do so within it
_STIFFNESS_MAX = 1e12  # [N/m]


class Physics(NamedTuple):
    """One tendon in its sheath, what holds its tip, and its start; (n,) is one value a sample."""

    friction: Array  # K, the friction coordinate of the tip, (n,)
    compliance: float  # L/EA [m/N]
    weights: Array  # share of the compliance at each node, (NODES,)
    tip_compliance: float = 0.0  # [m/N] of what the tip pulls at; 0 is a blocked tip
    drag: float = 0.0  # tau [N]: friction as if the tension were higher by so much
    viscosity: float = 0.0  # [N s/m]: the same in proportion to the local speed
    stribeck: float = 0.0  # friction times 1 + stribeck exp(-(v/stribeck_speed)^2)
    stribeck_speed: float = 1e-3  # [m/s]
    stribeck_memory: float = 0.0  # [s] that friction is late; 0: it follows the motor's speed
    static: float = 0.0  # friction of contacts at rest over that of sliding ones, less 1
    static_time: float = 0.1  # [s] of rest in which they get it
    static_distance: float = 1e-5  # [m] of sliding in which they lose it
    asymmetry: float = 1.0  # rho: friction towards the tip over friction towards the housing
    exponent: float = 1.0  # friction force ~ T^exponent
    reference: float = 10.0  # [N] of that power
    rise: float = 0.0  # [1/N] friction times 1 + rise T
    presliding: float = 0.0  # [m] that a contact gives before it slides
    presliding_tension: float = 0.0  # [N] at which it gives that much; 0: at any
    spectrum: Array = ONE_PLAY  # plays that share the force: threshold over K, share; (plays, 2)
    toe: float = 0.0  # [m] that the tendon stretches more at once, while strands bed in
    toe_tension: float = 2.0  # [N] over which it does
    creep: float = 0.0  # share of the elongation that comes late
    creep_time: float = 10.0  # [s]
    compression: float = 0.0  # [m/N^2] elongation above the threshold, by its square
    threshold: float = 0.0  # [N]
    stretch: Array = np.zeros(1)  # [m] by which the tendon is longer than it was, (n,) or (1,)
    tip_offset: Array = np.zeros(1)  # [m] by which the environment has taken the tip, (n,) or (1,)
    load_low: float = 0.0  # [N] at the tip, besides the spring, while it moves towards the tip
    load_high: float = 0.0  # [N] while it moves towards the housing
    load_stiffness: float = math.inf  # [N/m] with which one becomes the other
    contact: float = 0.0  # [m] of q_d from which on the tip meets something
    contact_stiffness: float = 0.0  # [N/m] of that; where the tip pulls at something
    mass: float = 0.0  # [kg] at the tip
    damping: float = 0.0  # [N s/m] at the tip
    start: float = 0.0  # [N] all along the tendon before the first sample
    earlier_turns: Array = np.empty(
        0
    )  # [m] or [N] from the first sample, where the drive turned before


class Motion(NamedTuple):
    """What the ends did, shape (n,) each."""

    proximal_tension: Array  # T_in [N]
    distal_tension: Array  # T_out [N]
    proximal_displacement: Array  # q_p [m], zero for the slack tendon
    distal_displacement: Array  # q_d [m], zero for the unloaded tip
    compliance: Array  # dq_p/dT_in [m/N] as the motor went on


class _Contacts(NamedTuple):
    """What contacts remember, shape (NODES - 1,) each."""

    direction: Array  # which way, 0 for those that stick
    speed: Array  # [m/s]
    adhesion: Array  # 1 for those that have taken hold, 0 for those that have let go


class _TipLoad(NamedTuple):
    """What the tip pulls at."""

    compliance: float  # [m/N]
    mass: float
    damping: float
    low: float
    high: float
    stiffness: float
    contact: float  # [m]
    contact_stiffness: float


_SCALARS = 30  # before the arrays in what `build_constants` returns
VISCOSITY, STRIBECK = 1, 2  # among them
CONSTANTS = _SCALARS + 4 * NODES - 1
LAST_SHARE = CONSTANTS - 1  # of the tip's force, that its own node has

# Where the parts of a state begin: of each node, of the ends, of each contact
LENGTHS, _CREEP, _ENDS = NODES, 2 * NODES, 3 * NODES
TIP = _ENDS  # where the tip's own node is [m]
_Q, _V, _A, _LOAD, _DRIVEN = range(_ENDS, _ENDS + 5)
_DIRECTION = _ENDS + 5
_SPEED, _ADHESION = _DIRECTION + NODES - 1, _DIRECTION + 2 * (NODES - 1)
STATE = _DIRECTION + 3 * (NODES - 1)
"""Length of the flat array that is all a tendon remembers."""

_NO_SPEEDS = np.empty(0)

WORK = WORK_ROWS + 7, NODES
"""Shape of what `advance` works in."""

# What `advance` is told of a sample
DT, FRICTION, STRETCH, OFFSET, COMPLIANCE, TARGET, SPEED = range(7)
SAMPLE = 7


class _Line(NamedTuple):
    """A tendon ready for steps."""

    law: FrictionLaw
    tip_load: _TipLoad
    total_compliance: float  # [m/N]: what the tension's rate is to the motor's speed
    weights: Array  # [m/N] of each node
    shares: Array  # of the weights, of each node
    ratios: Array  # speed over each contact for that of the motor, while all slides
    tip_shares: Array  # of the force at the tip, of each node


def simulate_by_travel(physics: Physics, time: Array, travel: Array, speed: Array) -> Motion:
    """Return what happens when the motor goes through a `travel`.

    Parameters
    ----------
    time : ndarray
        [s], shape (n,), rising.
    travel : ndarray
        q_p [m], shape (n,), zero where the tendon begins to be taut.
    speed : ndarray
        Of the motor [m/s], shape (n,); its sign does not matter.
    """
    return _simulate_drive(physics, time, travel, np.abs(speed), forced=False)


def simulate_by_tension(physics: Physics, time: Array, tension: Array, rate: Array) -> Motion:
    """Return what happens under a `tension` [N] at the housing that changes by `rate` [N/s]."""
    return _simulate_drive(physics, time, tension, np.abs(rate), forced=True)


def build_constants(physics: Physics) -> Array:
    """Return what `advance` needs to know of a tendon, as one flat array."""
    p = physics
    plays = distribute_spectrum(p.spectrum, p.weights)
    scalars = {name: getattr(p, name) for name in FrictionLaw._fields if name in p._fields}
    law = FrictionLaw(**scalars | {"toe": p.toe / p.compliance, "depth": plays.depth})
    stiffness = min(p.load_stiffness, _STIFFNESS_MAX)
    load = p.load_low, p.load_high, stiffness, p.contact, p.contact_stiffness
    tip_load = _TipLoad(p.tip_compliance, p.mass, p.damping, *load)
    line = np.array([*law, *tip_load])
    weights, K = plays.weights * p.compliance, plays.depth * float(p.friction[0])
    return _pack_line(line, p.tip_compliance, weights, K, plays.tip_shares)


class DrivenTendon:
    """A tendon that is driven by a travel or a tension in turn, from any of its samples on.

    Parameters
    ----------
    physics : Physics
        What is driven; its speed-dependent parts must be neutral.
    time : ndarray
        [s], shape (n,), rising.
    """

    def __init__(self, physics: Physics, time: Array) -> None:
        self._constants, self._samples = _prepare_samples(physics, time)
        self._memory = build_initial_state(
            self._constants, physics.start, *self._samples[0, [STRETCH, OFFSET]]
        )
        self._reached_sample = 0

    def copy(self) -> Self:
        """Return it where it is; what is done with the one leaves the other."""
        duplicate = copy(self)
        duplicate._memory = self._memory.copy()
        return duplicate

    def drive_by_travel(self, travel: Array, begin: int) -> Array:
        """Return T_in [N] from sample `begin` on under a `travel` [m], shape (n - begin,)."""
        memory = self._advance_to(travel, begin).copy()
        return self._advance(memory, travel[begin:], begin, forced=False)[:, 0]

    def drive_by_tension(self, travel: Array, begin: int, tension: Array) -> tuple[Array, Array]:
        """Return q_p [m] and dq_p/dT_in [m/N] under a tension [N] from `begin` on, shape of it.

        Before, it is driven by `travel` [m].
        """
        memory = self._advance_to(travel, begin).copy()
        memory[_DRIVEN] = np.nan
        motion = self._advance(memory, tension, begin, forced=True)
        return motion[:, 2], motion[:, 4]

    def _advance_to(self, travel: Array, begin: int) -> Array:
        """Return the state after the samples before `begin`, driven by `travel`."""
        self._advance(
            self._memory, travel[self._reached_sample : begin], self._reached_sample, forced=False
        )
        self._reached_sample = begin
        return self._memory

    def _advance(self, memory: Array, drive: Array, begin: int, *, forced: bool) -> Array:
        samples = self._samples[begin : begin + len(drive)].copy()
        samples[:, TARGET] = drive
        return _take_samples(self._constants, memory, samples, forced=forced)


def _prepare_samples(physics: Physics, time: Array) -> tuple[Array, Array]:
    """Return the constants of a tendon and its samples, undriven yet."""
    samples = np.zeros((len(time), SAMPLE))
    samples[:, DT] = np.diff(time, prepend=time[0])
    samples[:, FRICTION], samples[:, STRETCH] = physics.friction, physics.stretch
    samples[:, OFFSET], samples[:, COMPLIANCE] = physics.tip_offset, physics.tip_compliance
    return build_constants(physics), samples


def _simulate_drive(
    physics: Physics, time: Array, drive: Array, rate: Array, *, forced: bool
) -> Motion:
    constants, samples = _prepare_samples(physics, time)
    samples[:, TARGET], samples[:, SPEED] = drive, rate
    state = build_initial_state(constants, physics.start, samples[0, STRETCH], samples[0, OFFSET])
    if len(physics.earlier_turns):
        _approach_first_sample(constants, state, samples[0], physics.earlier_turns, forced=forced)
    out = _take_samples(constants, state, samples, forced=forced)
    return Motion(*np.ascontiguousarray(out.T))


def _take_samples(constants: Array, memory: Array, samples: Array, *, forced: bool) -> Array:
    """Take samples one after another, in place; return the rows of `Motion`, shape (n, 5)."""
    out = np.empty((len(samples), len(Motion._fields)))
    advance(constants, memory, samples, _NO_SPEEDS, forced, _SUBSTEP_MIN, np.empty(WORK), out)
    return out


def _approach_first_sample(
    constants: Array, state: Array, first: Array, earlier_turns: Array, *, forced: bool
) -> None:
    """Take a tendon from its start over earlier turns to the first sample, slowly, in place."""
    turns = np.concatenate([[0.0], np.maximum(first[TARGET] + earlier_turns, 0.0), [first[TARGET]]])
    drive = np.interp(
        np.arange(1, _APPROACH * (len(turns) - 1) + 1) / _APPROACH, range(len(turns)), turns
    )
    samples = np.repeat(first[None], len(drive), axis=0)
    samples[:, DT], samples[:, TARGET], samples[:, SPEED] = 1.0, drive, 0.0
    _take_samples(constants, state, samples, forced=forced)
    state[_V] = state[_A] = 0.0


@jit_compile
def _compute_speed_ratios(weights: Array, K: float, compliance: float) -> Array:
    """Return the speed over each contact for that of the motor, while all of the tendon slides."""
    n = len(weights)
    tension = np.exp(-K * PLACES)
    ratios = np.empty(n - 1)
    compliance_beyond = compliance * tension[n - 1]
    for j in range(n - 2, -1, -1):
        compliance_beyond += weights[j + 1] * tension[j + 1]
        ratios[j] = compliance_beyond
    ratios /= compliance_beyond + weights[0]
    return ratios


@jit_compile
def _pack_line(
    scalars: Array, compliance: float, weights: Array, friction: float, tip_shares: Array
) -> Array:
    """Return a `_Line` as one flat array; `scalars` are those of its law and its holder."""
    total_weight = weights.sum()
    row = np.empty(CONSTANTS)
    copy_values(scalars, row)
    row[_SCALARS - 1] = total_weight + compliance
    arrays = row[_SCALARS:]
    copy_values(weights, arrays)
    copy_values(weights / total_weight, arrays[NODES:])
    copy_values(_compute_speed_ratios(weights, friction, compliance), arrays[2 * NODES :])
    copy_values(tip_shares, arrays[-NODES:])
    return row


@jit_inline
def _unpack_line(constants: Array) -> _Line:
    """Return what `build_constants` has packed."""
    c, last = constants, NODES - 1
    law = FrictionLaw(
        c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], c[9],
        c[10], c[11], c[12], c[13], c[14], c[15], c[16], c[17], c[18], c[19], c[20],
    )  # fmt: skip
    tip_load = _TipLoad(c[21], c[22], c[23], c[24], c[25], c[26], c[27], c[28])
    weights, arrays = constants[_SCALARS : _SCALARS + NODES], constants[_SCALARS + NODES :]
    ratios, tip_shares = arrays[NODES : NODES + last], arrays[NODES + last :]
    return _Line(law, tip_load, c[29], weights, arrays[:NODES], ratios, tip_shares)


@jit_inline
def _distribute_tip_compliance(line: _Line) -> Array:
    """Return what the tip pulls at by each node but its own [m/N]: its share of the force there."""
    compliances = line.tip_load.compliance * line.tip_shares
    compliances[NODES - 1] = 0.0
    return compliances


@jit_compile
def build_initial_state(constants: Array, tension: float, stretch: float, offset: float) -> Array:
    """Return the state of a tendon that has not moved yet, at one `tension` [N] all along.

    It is `stretch` [m] longer than it was, and the environment has taken its tip to `offset` [m].
    """
    line = _unpack_line(constants)
    state = np.zeros(STATE)
    state[:NODES] = tension
    extra = line.shares * stretch
    empty = np.empty(0)
    tendon = Tendon(
        line.law, empty, empty, 0.0, line.weights, 1.0, extra, _distribute_tip_compliance(line)
    )
    for j in range(NODES):
        state[LENGTHS + j] = compute_elongation(tendon, j, tension)[0] + extra[j]
    state[_Q] = line.tip_load.compliance * line.tip_shares[NODES - 1] * tension + offset
    state[_DRIVEN] = math.nan
    state[_ADHESION:] = 1.0
    return state


@jit_compile
def slide_all(constants: Array, memory: Array, tension: float, log_ratio: float) -> None:
    """Let a tendon slide as a whole, in place.

    `tension` [N] is that at the housing; its logarithm, with drag, rises by `log_ratio` to the tip.
    """
    line = _unpack_line(constants)
    empty = np.empty(0)
    tendon = Tendon(
        line.law, empty, empty, 0.0, line.weights, 1.0, empty, _distribute_tip_compliance(line)
    )
    drag, last_tension = line.law.drag, memory[NODES - 1]
    for j in range(NODES):
        ratio = math.exp(log_ratio * line.law.depth * PLACES[j])
        memory[j] = max((tension + drag) * ratio - drag, 0.0)
        memory[LENGTHS + j] = compute_elongation(tendon, j, memory[j])[0] + memory[_CREEP + j]
    last_compliance = line.tip_load.compliance * line.tip_shares[NODES - 1]
    memory[_Q] += last_compliance * (memory[NODES - 1] - last_tension)


@jit_borrow
def advance(
    constants: Array,
    memory: Array,
    samples: Array,
    speeds: Array,
    forced: bool,
    share_min: float,
    work: Array,
    out: Array,
) -> None:
    """Take samples one after another, in place; fill in the rows of `Motion`, `out`, (n, 5).

    Parameters
    ----------
    constants, memory : ndarray
        From `build_constants` and `build_initial_state`, or a step before.
    samples : ndarray
        (n, SAMPLE): time since the sample before [s], K, `Physics.stretch` and `tip_offset` [m],
        `tip_compliance` [m/N], what the motor is driven to, and its speed.
    speeds : ndarray
        Over each contact [m/s], where Stribeck's friction shall not go by what the steps find;
        else empty.
    forced : bool
        Whether it is driven to a tension [N] and [N/s], or to a travel [m] and [m/s].
    share_min : float
        Share of a sample in which what has no balance yet is tried again; 1 for once only.
    work : ndarray
        To work in, shape `WORK`.
    """
    law, tip_load, total_compliance, weights, shares, ratios, tip_shares = _unpack_line(constants)
    last = NODES - 1
    last_share, buffers = tip_shares[last], work[WORK_ROWS:]
    tip_compliance, extra, T_new = buffers[0], buffers[1], buffers[2]
    half_k, drag = buffers[3, :last], buffers[4, :last]
    slip, total_slip = buffers[5, :last], buffers[6, :last]
    for j in range(NODES):
        tip_compliance[j] = 0.0 if j == last else tip_load.compliance * tip_shares[j]
        work[KNOWN, j] = buffers[6, j] = 0.0
    speeds_known = len(speeds) > 0
    has_memory = law.stribeck != 0.0 and law.stribeck_memory > 0.0
    has_plain_friction = law.rise == 0.0 and law.exponent == 1.0
    has_plain_friction &= law.stribeck == 0.0 and law.static == 0.0
    tension, lengths = memory[:NODES], memory[LENGTHS:_CREEP]
    creep, direction = memory[_CREEP:_ENDS], memory[_DIRECTION:_SPEED]
    speed, adhesion = memory[_SPEED:_ADHESION], memory[_ADHESION:]
    q, v, a, load, drive_old = memory[_Q], memory[_V], memory[_A], memory[_LOAD], memory[_DRIVEN]
    for i in range(len(samples)):
        dt, friction, stretch = samples[i, DT], samples[i, FRICTION], samples[i, STRETCH]
        compliance = last_share * samples[i, COMPLIANCE]
        target = samples[i, TARGET]
        rate = samples[i, SPEED]
        gain = -math.expm1(-dt / law.creep_time) if law.creep != 0.0 else 0.0
        for j in range(NODES):
            extra[j] = creep[j] * (1.0 - gain) + shares[j] * stretch
        scale = 1.0 + law.creep * gain
        tendon = Tendon(law, half_k, drag, dt, weights, scale, extra, tip_compliance)
        tip = _build_tip(tip_load, compliance, samples[i, OFFSET], dt, q, v, a, load)
        if law.stribeck != 0.0 and not has_memory:
            all_slide = rate * total_compliance if forced else rate
            for j in range(last):
                speed[j] = speeds[j] if speeds_known else ratios[j] * all_slide
        steady = has_plain_friction and i > 0 and friction == samples[i - 1, FRICTION]
        if not steady:
            fill_contacts(law, friction, tension, speed, adhesion, half_k, drag)
        if law.presliding > 0.0:
            slope_in = solve_presliding(tendon, tip, tension, lengths, target, forced, T_new)
            _store_tensions(tendon, T_new, tension, lengths)
        else:
            has_inertia = compliance > 0.0 and (tip_load.mass > 0.0 or tip_load.damping > 0.0)
            begin = target if math.isnan(drive_old) else drive_old
            tip, slope_in = _solve_substeps(
                tendon, tip, friction, begin, target, forced, 1.0 if has_inertia else share_min,
                _Contacts(direction, speed, adhesion), tension, lengths, T_new, slip, total_slip,
                work, steady,
            )  # fmt: skip
        if has_memory and dt > 0.0:
            share = -math.expm1(-dt / law.stribeck_memory)
            for j in range(last):
                sliding_speed = speeds[j] if speeds_known else abs(total_slip[j]) / dt
                speed[j] += share * (sliding_speed - speed[j])
        q_new, _slope, load = compute_tip_travel(tip, T_new[NODES - 1])
        if dt > 0.0:
            v_new = 2.0 * (q_new - q) / dt - v
            a = 2.0 * (v_new - v) / dt - a
            v = v_new
        q, drive_old = q_new, target
        if gain > 0.0:
            late_share = law.creep * gain / scale
            for j in range(NODES):
                elongation = lengths[j] - extra[j] - tip_compliance[j] * tension[j]
                creep[j] = creep[j] * (1.0 - gain) + late_share * elongation
        length, tip_tension, tip_travel = 0.0, 0.0, 0.0
        for j in range(NODES):
            length += lengths[j]
            tip_tension += tip_shares[j] * T_new[j]
            tip_travel += tip_compliance[j] * T_new[j]
        out[i, 0], out[i, 1] = T_new[0], tip_tension
        out[i, 2], out[i, 3], out[i, 4] = length + q, q + tip_travel, slope_in
    memory[_Q], memory[_V], memory[_A], memory[_LOAD], memory[_DRIVEN] = q, v, a, load, drive_old


@jit_inline
def _build_tip(
    tip_load: _TipLoad,
    compliance: float,
    offset: float,
    dt: float,
    q: float,
    v: float,
    a: float,
    load: float,
) -> Tip:
    """Return what the tip pulls at in a sample, its inertia by the trapezoidal rule.

    `q` [m], `v` [m/s] and `a` [m/s^2] are those of the tip one sample ago.
    """
    c, inertia_force = compliance, 0.0
    mass, damping = tip_load.mass, tip_load.damping
    has_inertia = compliance > 0.0 and (mass > 0.0 or damping > 0.0)
    if has_inertia and dt > 0.0:  # what follows from the past, and what is free
        displacement = q - offset
        c = compliance / (1.0 + compliance * (4.0 * mass / dt + 2.0 * damping) / dt)
        inertia_force = mass * (4.0 * (displacement / dt + v) / dt + a)
        inertia_force += damping * (2.0 * displacement / dt + v)
    return Tip(
        c, inertia_force, offset, tip_load.low, tip_load.high, tip_load.stiffness,
        tip_load.contact, tip_load.contact_stiffness, q, load,
    )  # fmt: skip


@jit_inline
def _solve_substeps(
    tendon: Tendon,
    tip: Tip,
    friction: float,
    begin: float,
    target: float,
    forced: bool,
    share_min: float,
    contacts: _Contacts,
    tension: Array,
    lengths: Array,
    T_new: Array,
    slip: Array,
    total_slip: Array,
    work: Array,
    steady: bool,
) -> tuple[Tip, float]:
    """Drive from `begin` to `target` with contacts that stick or slide, in as many parts as needed.

    Returns the tip as it is in the last part, and dq_p/dT_in [m/N]; fills `total_slip` [m].
    """
    law, half_k, drag = tendon.law, tendon.half_k, tendon.drag
    direction, speed, adhesion = contacts
    share_max = _SUBSTEP_MAX if law.static != 0.0 else 1.0
    progress, share, slope_in = 0.0, share_max, 0.0
    for j in range(len(slip)):
        total_slip[j] = 0.0
    while progress < 1.0:
        goal = begin + (progress + share) * (target - begin)
        substep = Tendon(
            law, half_k, drag, share * tendon.dt, tendon.weights, tendon.scale, tendon.extra,
            tendon.tip_compliance,
        )  # fmt: skip
        for attempt in range(2):
            converged, slope_in = solve_stick_slip(
                substep, tip, tension, lengths, goal, forced, T_new, direction, slip, work, steady
            )
            if converged or (attempt == 1 and share <= share_min):
                break
            for j in range(len(direction)):  # in circles: from rest, if need be by a smaller step
                direction[j] = 0.0
        if not converged and share > share_min:
            share *= 0.5
            continue
        progress += share
        share = min(2.0 * share, share_max, 1.0 - progress)
        for j in range(len(slip)):
            total_slip[j] += slip[j]
        _store_tensions(tendon, T_new, tension, lengths)
        if law.static != 0.0:
            age_contacts(law, substep.dt, slip, adhesion)
            fill_contacts(law, friction, tension, speed, adhesion, half_k, drag)
        q, _slope, load = compute_tip_travel(tip, T_new[NODES - 1])
        if progress < 1.0:
            tip = Tip(
                tip.compliance, tip.inertia_force, tip.offset, tip.low, tip.high, tip.stiffness,
                tip.contact, tip.contact_stiffness, q, load,
            )  # fmt: skip
    return tip, slope_in


@jit_inline
def _store_tensions(tendon: Tendon, T_new: Array, tension: Array, lengths: Array) -> None:
    """Take over the tensions that were found, and the lengths of the nodes that follow."""
    copy_values(T_new, tension)
    if tendon.law.toe != 0.0 or tendon.law.compression != 0.0:
        for j in range(NODES):
            lengths[j] = compute_elongation(tendon, j, T_new[j])[0] + tendon.extra[j]
        return
    for j in range(NODES):
        elongation = (
            tendon.scale * (tendon.weights[j] * T_new[j]) + tendon.tip_compliance[j] * T_new[j]
        )
        lengths[j] = elongation + tendon.extra[j]
