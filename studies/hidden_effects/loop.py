"""A closed loop of two cables by brute force in time: masses, springs, and LuGre bristles.

Nothing here knows a law of cable and sheath. Two rows of small masses go from a drive pulley to a
driven one, tied by springs that carry tension and no pressure. Each mass rubs on its sheath by a
bristle z (Canudas de Wit et al., IEEE Trans. Autom. Control 40, 1995):

    dz/dt = v - |v| z stiffness / limit,  force = stiffness z + damping dz/dt,
    limit = mu per mass * (tension here) + force per mass

Time goes in small explicit steps (semi-implicit Euler), with the inertia of everything.
"""

from dataclasses import dataclass

import numpy as np

from estimator.compiled import jit_compile

STEP = 5e-5  # [s]
FULL = 0.6  # [rad] that the drive turns at most


@dataclass(frozen=True)
class Loop:
    """Two equal cables between two pulleys."""

    radius: float = 0.006  # [m] of both pulleys
    K: float = 0.5  # friction of a sheath over the tension
    friction: float = 0.0  # [N] of a sheath at any tension
    give: float = 3e-6  # [m] that a bristle gives before it slides
    stiffness: float = 8000.0  # [N/m] EA/L of a cable
    pretension: float = 12.0  # [N]
    spring: float = 2500.0  # [N/m] at the driven pulley's rim; 0: held
    masses: int = 40  # of a cable
    mass: float = 0.01  # [kg] of each


def run(loop, time, angle):
    """Return torque at the drive [N m], torque and angle at the driven pulley; angle in [rad]."""
    out = _run(
        time,
        angle * loop.radius,
        loop.K / loop.masses,
        loop.friction / loop.masses,
        loop.give,
        loop.stiffness * (loop.masses + 1),
        loop.pretension,
        loop.spring,
        loop.masses,
        loop.mass,
    )
    return out[:, 0] * loop.radius, out[:, 1] * loop.radius, out[:, 2] / loop.radius


@jit_compile
def _run(time, travel, mu, force, give, k, pretension, spring, n, mass):
    """Return forces at both rims [N], and the driven rim's travel [m], (samples, 3).

    Both cables are rows towards the driven pulley; the second is pulled the other way.
    """
    x, v, z = np.zeros((2, n)), np.zeros((2, n)), np.zeros((2, n))
    T = np.full((2, n + 1), pretension)
    bristle = (mu * pretension + force) / give
    damping = 0.1 * np.sqrt(mass * k)
    sway = 0.3 * np.sqrt(mass * bristle)
    q = u = 0.0
    rim = 2.0 * mass
    steps = round((time[1] - time[0]) / STEP)
    out = np.empty((len(time), 3))
    for i in range(len(time)):
        begin = travel[max(i - 1, 0)]
        for s in range(steps):
            motor = begin + (travel[i] - begin) * (s + 1) / steps
            speed = (travel[i] - begin) / (steps * STEP)
            for c in range(2):
                sign = 1.0 if c == 0 else -1.0
                left, v_left = sign * motor, sign * speed
                for j in range(n + 1):
                    right = x[c, j] if j < n else sign * q
                    v_right = v[c, j] if j < n else sign * u
                    T[c, j] = max(
                        pretension + k * (left - right) + damping * (v_left - v_right), 0.0
                    )
                    left, v_left = right, v_right
            for c in range(2):
                for j in range(n):
                    limit = mu * 0.5 * (T[c, j] + T[c, j + 1]) + force
                    limit = max(limit, 1e-6)
                    end = limit / bristle if v[c, j] > 0.0 else -limit / bristle
                    late = end + (z[c, j] - end) * np.exp(-abs(v[c, j]) * STEP * bristle / limit)
                    rate = (late - z[c, j]) / STEP
                    z[c, j] = late
                    rub = bristle * z[c, j] + sway * rate
                    v[c, j] += STEP * (T[c, j] - T[c, j + 1] - rub) / mass
                    x[c, j] += STEP * v[c, j]
            if spring > 0.0:
                pull = T[0, n] - T[1, n]
                u += STEP * (pull - spring * q - 0.1 * np.sqrt(rim * spring) * u) / rim
                q += STEP * u
        out[i] = T[0, 0] - T[1, 0], T[0, n] - T[1, n], q
    return out


def draw_motion(seed, duration=40.0, rate=100.0):
    """Return time [s] and the drive pulley's angle [rad]: swings of several depths, both ways."""
    rng = np.random.default_rng(seed)
    ends = [0.0, 1.0, -1.0, 0.7, -0.4, 0.5, -0.8, 0.2, -0.1, 0.6, 0.0, -0.9, 0.9, -0.5, 0.3]
    corners = FULL * np.array(ends) * rng.uniform(0.85, 1.0, len(ends))
    ways = np.abs(np.diff(corners)) * rng.uniform(0.7, 1.4, len(ends) - 1)
    rests = np.where(rng.random(len(ends) - 1) < 0.4, 0.5, 0.05)
    moves = ways / ways.sum() * (duration - rests.sum() - 0.6)
    arrivals = 0.3 + np.cumsum(moves + rests) - rests
    times = np.concatenate([[0.0, 0.3], np.ravel(np.column_stack([arrivals, arrivals + rests]))])
    angles = np.repeat(corners, 2)
    time = np.arange(round(duration * rate)) / rate
    width = max(1, round(0.15 * rate))
    padded = np.interp(np.arange(-width, len(time)) / rate, times, angles)
    sums = np.cumsum(np.insert(padded, 0, 0.0))
    return time, ((sums[width:] - sums[:-width]) / width)[1 : len(time) + 1]
