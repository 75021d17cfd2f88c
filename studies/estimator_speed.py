"""How fast the estimator is, against two plain ways of writing the same law, in the same run.

python -m studies.estimator_speed

A step from Python, with the law alone and with an effect beside it; a compiled run over a record;
the law alone against a numpy clip for each node and a stack in pure Python; and what adaptation of
K adds to a tick of 8 joints. Takes 30 s.
"""

import functools
import math
import time
from collections import deque

import numpy as np

from estimator.adaptation import UPDATE_S, Adaptation, build_adaptation, observe
from estimator.array_types import Array
from estimator.compiled import jit_compile
from estimator.effects import elasticity, friction
from estimator.effects.effect import Effect, Values
from estimator.law.sheath import Sheath
from estimator.law.transmission import build_slack_profile, build_tables, simulate_tensions
from estimator.online import online
from estimator.online.extended_model import build_extended_model
from estimator.online.tendon_estimate import TendonEstimate
from estimator.pair_adaptation import PairAdaptation, observe_pair
from estimator.structs import StructArray
from studies.adaptation import UNCHANGED, simulate_use
from studies.testbed.command import measure_us, parse_options

SHEATH = Sheath.uniform(1.0, 1.5, 9000.0)
NODES = 64
JOINTS = 8
RATE = 1000.0  # [Hz]

BESIDE: tuple[tuple[Effect, Values], ...] = (
    (friction.VISCOUS_FRICTION, (200.0,)),
    (friction.STRIBECK_WITH_MEMORY, (0.2, 1e-3, 0.1)),
    (friction.PRESLIDING_STIFF, (3e-5,)),
    (friction.TENSION_DEPENDENT_POWER, (0.9,)),
    (elasticity.NONLINEAR_STIFFNESS, (1e-4, 2.0)),
    (elasticity.CREEP, (0.08, 8.0)),
)
"""Effects that are run beside the law, each in a model of its own."""


def simulate_hand(n: int) -> tuple[Array, Array, Array]:
    """Return time, T_in and q_p of a restless hand."""
    rng = np.random.default_rng(0)
    time_s = np.arange(n) / RATE
    tones = zip(
        rng.uniform(0.2, 5.0, 6), rng.uniform(0.0, 6.0, 6), rng.uniform(0.5, 1.5, 6), strict=True
    )
    T = 8.0 + sum(a * np.sin(2 * math.pi * f * time_s + p) for f, p, a in tones)
    T = np.maximum(T, 0.2)
    table = build_tables(SHEATH)
    _, e = simulate_tensions(table, build_slack_profile(table), T)
    return time_s, T + rng.normal(0.0, 0.02, n), e + rng.normal(0.0, 1e-6, n)


def sweep_nodes(T_in: Array) -> Array:
    """Baseline: the law on 64 nodes, one numpy clip for each node and sample."""
    ds = SHEATH.K / (NODES - 1)
    s = np.arange(NODES) * ds
    y = np.full(NODES, math.log(1e-9))
    T_out = np.empty_like(T_in)
    for i, u in enumerate(np.log(np.maximum(T_in, 1e-9))):
        y = np.minimum(np.maximum(y, u - s), u + s)
        T_out[i] = math.exp(y[-1])
    return T_out


def run_stack(T_in: Array) -> Array:
    """Baseline: the stack of break points in pure Python, tension only, no elongation."""
    K = SHEATH.K
    points: deque[tuple[float, float]] = deque([(0.0, math.log(1e-9)), (K, math.log(1e-9))])
    T_out = np.empty_like(T_in)
    for i, T in enumerate(T_in):
        u = math.log(max(T, 1e-9))
        slope = -1.0 if u > points[0][1] else 1.0
        s_a, y_a = points.popleft()
        while points:
            s_b, y_b = points[0]
            if -slope * (u + slope * s_b - y_b) < 0.0:
                m = (y_b - y_a) / (s_b - s_a)
                s = (u - y_a + m * s_a) / (m - slope) if m != slope else s_b
                points.appendleft((s, u + slope * s))
                break
            s_a, y_a = points.popleft()
        else:
            points.append((K, u + slope * K))
        points.appendleft((0.0, u))
        T_out[i] = math.exp(points[-1][1])
    return T_out


def time_steps(model: online.TendonModel, T: Array, q: Array) -> Array:
    """Return how long each step took [us], in order of that."""
    prepared = online.prepare(model)
    state = online.build_initial_state(prepared)
    rows = list(zip(T.tolist(), q.tolist(), strict=True))
    _, state = online.step(prepared, state, *rows[0], 0.0)
    taken = []
    for tension, travel in rows[1:]:
        start = time.perf_counter_ns()
        _, state = online.step(prepared, state, tension, travel, 1.0 / RATE)
        taken.append(time.perf_counter_ns() - start)
    return np.sort(np.array(taken)) / 1e3


def print_steps(T: Array, q: Array) -> None:
    """Print what a step costs with the law alone, and with an effect beside it."""
    noisy = functools.partial(online.TendonModel, tension_noise=0.02, displacement_noise=1e-6)
    law = time_steps(noisy(SHEATH), T, q)
    print(f"{'online.step from Python':34}    min [us]   median   99.9 %   largest   times the law")
    models = {"the law": law}
    shared = (SHEATH.K, SHEATH.length / SHEATH.axial_stiffness, 5e-4)
    for effect, values in BESIDE:
        found = build_extended_model(shared, [(effect, values)], 60.0, SHEATH.length)
        models[effect.name] = time_steps(noisy(found.sheath, extension=found.extension), T, q)
    for name, taken in models.items():
        p999 = taken[int(0.999 * len(taken))]
        print(f"{name:34}{taken[0]:12.2f}{np.median(taken):9.2f}{p999:9.1f}{taken[-1]:10.0f}"
              f"{np.median(taken) / np.median(law):16.1f}")  # fmt: skip
    print()


@jit_compile
def take_sample(
    constants: StructArray,
    singles: StructArray,
    pairs: StructArray,
    prepared: StructArray,
    estimators: StructArray,
    estimates: StructArray,
    sample: Array,
    loop: Array,
    dt: float,
) -> None:
    """Estimate T_in [N] and q_p [m] of all tendons; adapt `singles`, or `pairs` of neighbours."""
    for i in range(len(prepared)):
        T, q = sample[0, i], sample[1, i]
        online.advance(prepared[i], estimators[i], T, q, dt, estimates[i], None)
    for i in range(len(singles)):
        observe(constants[i], singles[i], prepared[i], estimators[i], estimates[i], loop, dt)
    for k in range(len(pairs)):
        i, j = 2 * k, 2 * k + 1
        observe_pair(
            constants[i], constants[j], pairs[k], prepared[i], prepared[j],
            estimators[i], estimators[j], estimates[i], estimates[j], loop, loop, dt,
        )  # fmt: skip


def time_ticks(pair: bool, adapts: bool) -> Array:
    """Return the least of three times [us] of each tick of `JOINTS` joints that move alike."""
    use = simulate_use(0, pair, UNCHANGED)
    models = use.models * JOINTS
    rows = np.tile(np.stack([use.tension, use.travel], 1), JOINTS)
    constants, loop = np.concatenate([build_adaptation(m) for m in models]), np.full(2, np.nan)
    taken = np.empty((3, len(rows)))
    for run in taken:
        singles = Adaptation.array(len(models) * (adapts and not pair))
        pairs = PairAdaptation.array(JOINTS * (adapts and pair))
        for joint, state in enumerate(pairs):  # as in a session: not all update in one tick
            state["a"]["update_age"] = joint / JOINTS * UPDATE_S
            state["b"]["update_age"] = (joint + 0.5) / JOINTS * UPDATE_S
        singles["update_age"] = np.arange(len(singles)) / max(len(singles), 1) * UPDATE_S
        prepared = online.prepare_all(models)
        states = (
            prepared,
            online.build_initial_states(prepared),
            TendonEstimate.array(len(models)),
        )
        for n, sample in enumerate(rows):
            start = time.perf_counter_ns()
            take_sample(constants, singles, pairs, *states, sample, loop, 2e-3)
            run[n] = time.perf_counter_ns() - start
    return taken.min(axis=0)[1:] / 1e3


def print_adaptation() -> None:
    """Print what adaptation of K adds to a tick."""
    print(f"{f'tick of {JOINTS} joints [us]':34}  median   99.9 %   largest   times fixed K")
    for pair in (False, True):
        fixed = time_ticks(pair, adapts=False)
        for adapts, taken in ((False, fixed), (True, time_ticks(pair, adapts=True))):
            name = f"{'pairs' if pair else 'single tendons'}, {'adapted' if adapts else 'fixed K'}"
            print(f"{name:34}{np.median(taken):8.1f}{np.percentile(taken, 99.9):9.1f}"
                  f"{taken.max():10.1f}{np.median(taken) / np.median(fixed):16.2f}")  # fmt: skip
    print()


def main() -> None:
    parse_options(__doc__)
    print_adaptation()
    time_s, T, q = simulate_hand(20_000)
    print_steps(T, q)
    prepared = online.prepare(
        online.TendonModel(SHEATH, tension_noise=0.02, displacement_noise=1e-6)
    )
    full = 1e-6 * measure_us(lambda: online.run(prepared, time_s, T, q))
    table = build_tables(SHEATH)
    law = 1e-6 * measure_us(lambda: simulate_tensions(table, build_slack_profile(table), T))
    short = 4000
    sweep = 1e-6 * measure_us(lambda: sweep_nodes(T[:short]), repeat=3) * len(T) / short
    stack = 1e-6 * measure_us(lambda: run_stack(T), repeat=3)
    exact, _ = simulate_tensions(table, build_slack_profile(table), T)
    print(f"{'':34}Msamples/s   faster than numpy clip sweep   than Python deque")
    for name, taken_s in (
        ("online.run (tension+displacement)", full),
        ("transmission.batch (law alone)", law),
        (f"numpy clip sweep, {NODES} nodes", sweep),
        ("Python deque", stack),
    ):
        print(f"{name:34}{len(T) / taken_s / 1e6:10.3f}   {sweep / taken_s:28.1f}"
              f"   {stack / taken_s:17.1f}")  # fmt: skip
    print(f"same T_out: sweep to {np.abs(sweep_nodes(T[:short]) - exact[:short]).max():.1e} N, "
          f"deque to {np.abs(run_stack(T) - exact).max():.1e} N")  # fmt: skip


if __name__ == "__main__":
    main()
