"""A tendon as a line of springs and Coulomb-friction beads, brute force.

Nothing here knows a law of tendon and sheath: there are springs, which carry tension and no
pressure, and beads, each with a bend angle, over which the tension may jump by at most

    limit = coefficient * angle * (mean tension + drag + viscosity |v|)

Travels x are positive towards the housing. Node 0 is the motor, a held position; node `tip` is tied
to the bench; with an antagonist the line goes on behind the tip, through a second sheath, to a
housing that pulls with a constant tension. A step is implicit in time: each bead is guessed to
stick or to slide one way, the balance of all nodes is solved, and guesses that Coulomb contradicts
are corrected until none is left. What is returned satisfies every condition, however it was found.
"""

from typing import NamedTuple

import numpy as np

from estimator.compiled import jit_compile

LOOSE = 1e-9  # stiffness of a slack spring over that of a taut one, for a unique answer
FLAT = 1e-3  # [N] below which friction's power of tension stops
BRISTLE_AT = 10.0  # [N] of the reach of bristles
SMALLEST = 1e-6  # share of a step
BLOCKED, SPRUNG = 0, 1


class Line(NamedTuple):
    """The beads and springs: angle, length and sheath of each."""

    length: np.ndarray  # [m] of each spring, motor first
    friction: np.ndarray  # coefficient * angle at each node; 0 at the ends and the tip
    tip: int  # node
    stiffness: float  # EA [N]
    behind: float  # [N] tension at the antagonist's housing


class Law(NamedTuple):
    """Deviations from elastic springs and Coulomb beads; the default has none."""

    drag: float = 0.0  # [N]
    viscosity: float = 0.0  # [N s/m]
    stribeck_ratio: float = 0.0
    stribeck_speed: float = 1e-3  # [m/s]
    stribeck_memory: float = 0.2  # [s] by which friction is late
    bristle: float = 0.0  # [m] that a contact gives at 10 N before it slides
    asymmetry: float = 1.0  # limit of sliding to the tip over that to the housing
    exponent: float = 1.0  # of tension in friction, neutral at 10 N
    static_excess: float = 0.0  # of the friction after a long rest
    static_time: float = 0.5  # [s] of rest that it takes
    static_distance: float = 2e-5  # [m] of sliding that undoes it
    toe_strain: float = 0.0
    toe_tension: float = 2.0  # [N]
    creep_share: float = 0.0
    creep_time: float = 8.0  # [s]
    compression: float = 0.0  # [m/N^2] of the sheath, at the housing
    compression_threshold: float = 0.0  # [N]
    slack: float = 0.0  # [m] of tendon too much


class Tip(NamedTuple):
    """What holds the tip: a wall or a spring, with dry friction, mass and damper."""

    kind: int = BLOCKED
    stiffness: float = 0.0  # [N/m]
    friction: float = 0.0  # [N]
    mass: float = 0.0  # [kg]
    damping: float = 0.0  # [N s/m]
    stop: float = 0.0  # [m] from where on it is held by a second spring
    stop_stiffness: float = 0.0  # [N/m] of that


class State(NamedTuple):
    """All that the line remembers."""

    x: np.ndarray  # [m] travel of each node
    tension: np.ndarray  # [N] of each spring
    sliding: np.ndarray  # +1 towards the housing, -1 towards the tip, 0 sticks
    root: np.ndarray  # [m] of each bead's bristle in the sheath
    speed: np.ndarray  # [m/s] that friction knows of
    rested: np.ndarray  # 0..1
    creep: np.ndarray  # strain
    body: np.ndarray  # speed and acceleration of the tip


def build_line(sections, friction, stiffness, *, beads=120, antagonist=None):
    """Return a line through `sections` of (length, angle); `antagonist`: (sections, tension)."""
    length, angle = _divide_sheath(sections, beads)
    tip, behind = len(angle) + 1, 0.0
    angle = np.concatenate([[0.0], angle, [0.0]])
    if antagonist is not None:
        further, behind = antagonist
        more, bends = _divide_sheath(further, beads // 2)
        length = np.concatenate([length, more])
        angle = np.concatenate([angle, bends, [0.0]])
    return Line(length, friction * angle, tip, stiffness, behind)


def _divide_sheath(sections, beads):
    """Return spring lengths and bead angles, each bead in the middle of its piece of sheath.

    Pieces grow from the driven end: after a reversal the tension there changes with the root of the
    travel, and pieces of one length would be far too coarse for it.
    """
    lengths, angles = np.transpose(sections)
    ends = np.cumsum(lengths)[-1] * np.linspace(0.0, 1.0, beads + 1) ** 2
    angle = np.interp(ends, np.cumsum([0.0, *lengths]), np.cumsum([0.0, *angles]))
    half = np.diff(ends) / 2
    return np.append(half, 0.0) + np.insert(half, 0, 0.0), np.diff(angle)


def build_resting_state(line, law, tip, tension=0.0):
    """Return the state of a line with one tension from housing to tip."""
    n = len(line.friction)
    start = np.full(n - 1, tension)
    start[line.tip :] = line.behind
    stretch = [stretched(line, law, j, T, 0.0, 0.0, 0.01) for j, T in enumerate(start)]
    x = -np.concatenate([[0.0], np.cumsum(stretch)])
    if line.behind == 0.0 and tension == 0.0:
        x[0] = x[1]  # the motor has not begun to take up the slack
    sprung = tip.kind == SPRUNG
    x += (tension - line.behind) / tip.stiffness - x[line.tip] if sprung else -x[line.tip]
    still, stuck = np.zeros(n), np.zeros(n, np.int64)
    return State(x, start, stuck, x.copy(), still, still + 1.0, np.zeros(n - 1), np.zeros(2))


@jit_compile
def stretched(line, law, j, T, creep, growth, dt):
    """Return how much longer than its place spring `j` is at tension T >= 0 [m]."""
    h = dt / law.creep_time
    strain = T / line.stiffness * (1.0 + law.creep_share * h / (1.0 + h)) + creep / (1.0 + h)
    strain += law.toe_strain * (1.0 - np.exp(-T / law.toe_tension)) + growth
    more = 0.0
    if j == 0:
        more = law.slack + law.compression * max(T - law.compression_threshold, 0.0) ** 2
    return line.length[j] * strain + more


@jit_compile
def _compliance(line, law, j, T, dt):
    h = dt / law.creep_time
    per_length = (1.0 + law.creep_share * h / (1.0 + h)) / line.stiffness
    per_length += law.toe_strain / law.toe_tension * np.exp(-T / law.toe_tension)
    more = 0.0
    if j == 0:
        more = 2.0 * law.compression * max(T - law.compression_threshold, 0.0)
    return line.length[j] * per_length + more


@jit_compile
def _pull(line, law, j, stretch, guess, creep, growth, dt):
    """Return the tension of spring `j` at a stretch, and its stiffness."""
    loose = stretched(line, law, j, 0.0, creep, growth, dt)
    if stretch < loose:
        k = LOOSE * line.stiffness / line.length[j]
        return k * (stretch - loose), k
    T = max(guess, 0.0)
    for _ in range(60):
        error = stretched(line, law, j, T, creep, growth, dt) - stretch
        step = error / _compliance(line, law, j, T, dt)
        T = max(T - step, 0.0)
        if abs(step) < 1e-12:
            break
    return T, 1.0 / _compliance(line, law, j, T, dt)


@jit_compile
def _limit(line, law, i, load, speed, direction, scale, state):
    """Return the most that bead `i` holds, its slope in the load and in the speed.

    The speed is that along `direction`; against it a bead does not slide.
    """
    factor = scale * line.friction[i]
    if direction < 0:
        factor *= law.asymmetry
    factor *= 1.0 + law.stribeck_ratio * np.exp(-((state.speed[i] / law.stribeck_speed) ** 2))
    factor *= 1.0 + law.static_excess * state.rested[i]
    press = max(load, 0.0)
    slope = 1.0 if load > 0.0 else 0.0
    if law.exponent != 1.0:
        power = (max(press, FLAT) / 10.0) ** (law.exponent - 1.0)
        slope *= power * (law.exponent if press > FLAT else 1.0)
        press *= power
    total = press + law.drag + law.viscosity * speed
    return factor * total, factor * slope, factor * law.viscosity


@jit_compile
def _solve(system):
    """Solve a tridiagonal system (rows below, on and above the diagonal, right side) in place."""
    lower, diagonal, upper, right = system
    n = len(right)
    for i in range(1, n):
        w = lower[i] / diagonal[i - 1]
        diagonal[i] -= w * upper[i - 1]
        right[i] -= w * right[i - 1]
    right[n - 1] /= diagonal[n - 1]
    for i in range(n - 2, -1, -1):
        right[i] = (right[i] - upper[i] * right[i + 1]) / diagonal[i]


@jit_compile
def _hold(tip, state, before, at, wall, dt):
    """Return a and b of the bench's force a x - b on a sprung tip at x, by Newmark's rule.

    `at` [m] is where it is about: beyond the stop, or not.
    """
    inertia, damping = 4.0 * tip.mass / dt**2, 2.0 * tip.damping / dt
    b = (inertia + damping) * before + tip.stiffness * wall
    b += (4.0 * tip.mass / dt + tip.damping) * state.body[0] + tip.mass * state.body[1]
    stop = tip.stop_stiffness if at > wall + tip.stop else 0.0
    return tip.stiffness + inertia + damping + stop, b + stop * (wall + tip.stop)


@jit_compile
def _equations(line, law, tip, state, k, before, hold, outside, dt, system):
    """Write what the nodes lack for their balance, and its slopes: a tridiagonal `system`."""
    n, t = len(line.friction), line.tip
    x, T = state.x, state.tension
    lower, diagonal, upper, right = system
    lower[:], upper[:], diagonal[:] = 0.0, 0.0, 1.0
    right[0] = outside[0] - x[0]
    for i in range(1, n):
        last, d = i == n - 1, state.sliding[i]
        behind = 0.0 if last else T[i]
        stiff = 0.0 if last else k[i]
        jump = T[i - 1] - behind
        lower[i], diagonal[i], upper[i] = k[i - 1], -k[i - 1] - stiff, stiff
        if i == t and tip.kind == BLOCKED:
            lower[i], diagonal[i], upper[i], right[i] = 0.0, 1.0, 0.0, outside[1] - x[i]
        elif i == t and (d != 0 or tip.friction == 0.0):
            diagonal[i] -= hold[0]
            right[i] = hold[0] * x[i] - hold[1] + d * tip.friction - jump
        elif i != t and last:  # the antagonist's housing
            right[i] = line.behind - jump
        elif i == t or (d == 0 and law.bristle == 0.0):
            lower[i], diagonal[i], upper[i], right[i] = 0.0, 1.0, 0.0, before[i] - x[i]
        elif d == 0:
            bristle = line.friction[i] * BRISTLE_AT / law.bristle
            diagonal[i] -= bristle
            right[i] = bristle * (x[i] - state.root[i]) - jump
        else:
            speed, load = d * (x[i] - before[i]) / dt, (T[i - 1] + behind) / 2
            limit, per_load, per_speed = _limit(line, law, i, load, speed, d, outside[2], state)
            a, b = 1.0 - d * per_load / 2, 1.0 + d * per_load / 2
            lower[i], upper[i] = a * k[i - 1], b * stiff
            diagonal[i] = -lower[i] - upper[i] - per_speed / dt
            right[i] = d * limit - jump


@jit_compile
def _corrected(line, law, tip, state, before, hold, outside):
    """Change guesses that Coulomb contradicts; return whether there was none."""
    t, x, T = line.tip, state.x, state.tension
    agreed = True
    tolerance = 1e-10 * (1.0 + T.max())
    for i in range(1, len(T) + (tip.friction > 0.0 and t == len(T))):
        if i == t and tip.friction == 0.0:
            continue
        behind = T[i] if i < len(T) else 0.0
        jump, d = T[i - 1] - behind, state.sliding[i]
        if i == t:
            jump -= hold[0] * x[i] - hold[1]
        if d == 0:
            d = 1 if jump > 0.0 else -1
            limit = tip.friction
            if i != t:
                load = (T[i - 1] + behind) / 2
                limit = _limit(line, law, i, load, 0.0, d, outside[2], state)[0]
            if abs(jump) > limit + tolerance:
                state.sliding[i] = d
                agreed = False
        else:
            slid = x[i] - before[i]
            if i != t and law.bristle > 0.0:
                slid = _root(line, law, i, x[i], jump) - state.root[i]
            if slid * d < -1e-14:
                state.sliding[i] = 0
                agreed = False
    return agreed


@jit_compile
def _root(line, law, i, x, jump):
    """Return where in the sheath the bristle of a bead at `x` begins that carries `jump`."""
    return x - jump * law.bristle / (line.friction[i] * BRISTLE_AT)


@jit_compile
def _balance(line, law, tip, state, outside, dt):
    """Find the equilibrium at the end of a step; of the state only x, tension, sliding change.

    Returns whether one was found.
    """
    n, x = len(line.friction), state.x
    before, k, system = x.copy(), np.empty(n - 1), np.empty((4, n))
    _stretch(line, law, state, outside, dt, k)
    for _ in range(4 * n):
        hold = _hold(tip, state, before[line.tip], x[line.tip], outside[1], dt)
        _equations(line, law, tip, state, k, before, hold, outside, dt, system)
        _solve(system)
        x += system[3]
        if _stretch(line, law, state, outside, dt, k):
            continue  # springs went slack or taut: their tensions say nothing about beads yet
        agreed = _corrected(line, law, tip, state, before, hold, outside)
        if agreed and np.abs(system[3]).max() < 1e-13:
            return True
    return False


@jit_compile
def _stretch(line, law, state, outside, dt, k):
    """Renew the tension and stiffness of springs; return whether any went slack or taut."""
    turned, x, T = False, state.x, state.tension
    for j in range(len(T)):
        slack = T[j] < 0.0
        T[j], k[j] = _pull(line, law, j, x[j] - x[j + 1], T[j], state.creep[j], outside[3], dt)
        turned |= slack != (T[j] < 0.0)
    return turned


@jit_compile
def advance(line, law, tip, state, outside, dt):
    """Take the line through one step; return the heat of friction [J], or nan without an answer."""
    n, t = len(line.friction), line.tip
    before, tensions = state.x.copy(), state.tension.copy()
    found = _balance(line, law, tip, state, outside, dt)
    if not found:  # guesses from the last step went in circles: guess that all sticks
        state.x[:], state.tension[:], state.sliding[:] = before, tensions, 0
        found = _balance(line, law, tip, state, outside, dt)
    if not found:
        state.x[:], state.tension[:] = before, tensions
        return np.nan
    x, T, heat = state.x, state.tension, 0.0
    for i in range(1, n - 1):
        moved = x[i] - before[i]
        if i != t:
            jump = T[i - 1] - T[i]
            root = x[i]
            if law.bristle > 0.0:
                root = state.root[i]
                if state.sliding[i] != 0:
                    root = _root(line, law, i, x[i], jump)
            heat += jump * (root - state.root[i])
            state.root[i] = root
        speed = abs(moved) / dt
        state.speed[i] += (speed - state.speed[i]) * (1.0 - np.exp(-dt / law.stribeck_memory))
        rested = 1.0 - (1.0 - state.rested[i]) * np.exp(-dt / law.static_time)
        state.rested[i] = rested * np.exp(-abs(moved) / law.static_distance)
    h = dt / law.creep_time
    for j in range(n - 1):
        gain = h * law.creep_share * max(T[j], 0.0) / line.stiffness
        state.creep[j] = (state.creep[j] + gain) / (1.0 + h)
    moved = x[t] - before[t]
    speed, acceleration = state.body[0], state.body[1]
    state.body[0] = 2.0 * moved / dt - speed
    state.body[1] = 4.0 * moved / dt**2 - 4.0 * speed / dt - acceleration
    return heat


@jit_compile
def step(line, law, tip, state, before, after, dt):
    """Take the line from one set of outside conditions to the next; return the heat [J].

    Conditions are motor [m], wall [m], scale of friction, growth [strain]. Where there is no answer
    within reach of the last one they change in smaller parts.
    """
    done, part, heat = 0.0, 1.0, 0.0
    while done < 1.0:
        part = min(part, 1.0 - done)
        more = advance(line, law, tip, state, before + (done + part) * (after - before), dt * part)
        if np.isnan(more):
            part /= 4.0
            if part < SMALLEST:
                raise RuntimeError("the chain found no equilibrium")
        else:
            done += part
            heat += more
            part *= 2.0
    return heat


@jit_compile
def run(line, law, tip, state, outside, period, parts):
    """Take the line through a record of conditions, a row each, of as many steps as `parts`.

    Returns columns T_in [N], q_p [m], T_out [N], q_d [m], heat since the start [J].
    """
    n = len(outside)
    out = np.empty((n, 5))
    heat, t = 0.0, line.tip
    for i in range(n):
        last, here = outside[max(i - 1, 0)], outside[i]
        for part in range(parts):
            a, b = last + part / parts * (here - last), last + (part + 1) / parts * (here - last)
            heat += step(line, law, tip, state, a, b, period / parts)
        T_in, T_out = max(state.tension[0], 0.0), max(state.tension[t - 1], 0.0)
        out[i] = T_in, state.x[0], T_out, state.x[t], heat
    return out
