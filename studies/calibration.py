"""How well a blocked-tip loop calibrates random sheaths, beside the paper's method.

python -m studies.calibration [--sheaths 60] [--seed 1] [--peak 20] [--loops 1]

Each sheath, uniform or of 2 to 5 bends and straight stretches, K from 0.4 to 1.8, is a chain of
springs and friction beads that knows no law (studies/brute_force). Its loop, pull to the peak (20
N), release to 0.2 N and pull again, as often as `loops` says, in 1, 3, 3, ... s with rests of 0.2
s, is read with 0.01 to 0.03 N of noise and encoder counts and calibrated; the paper's method is
given the true EA and L. Then the same chain goes through pull 20 N, release 5 N, pull 20 N and
nested partial reversals, and the law predicts T_out and elongation from the noise-free T_in: errors
in percent of full scale, the largest of the motion. Takes a minute.
"""

import itertools
import math
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from estimator.calibration.calibration import Calibration, CalibrationError, calibrate
from estimator.law.sheath import Section, Sheath
from estimator.law.transmission import build_slack_profile, build_tables, simulate_tensions
from studies.brute_force.chain import Chain, Force, Position
from studies.testbed.command import parse_options

LOW = 0.2  # [N]
FIRST, OTHERS = 1.0, 3.0  # [s] of the first pull, and of each branch after it
REST = 0.2  # [s] at each turn
COUNT = 2.0 * math.pi * 0.010 / 67_000  # [m]
MOTION = (LOW, 20.0, 5.0, 20.0, 6.0, 16.0, 8.0, 13.0, 3.0, 18.0, 1.0, 10.0)  # [N]
BEAD = 0.03  # largest friction of a bead
HELD = Position(0.0)
SHARES = (0.5, 0.8, 0.9, 0.95, 1.0)


class Row(NamedTuple):
    """Errors on one sheath: of K, and in percent of full scale of T_out and elongation."""

    name: str
    K: float
    uncertainty: float  # standard, of K
    T_out: float
    elongation: float
    paper_tension: float
    paper_elongation: float


def draw_sheath(rng: np.random.Generator) -> Sheath:
    while True:
        K, length, EA = rng.uniform(0.4, 1.8), rng.uniform(1.0, 2.0), rng.uniform(5e3, 15e3)
        count = 1 if rng.uniform() < 0.25 else int(rng.integers(2, 6))
        lengths = length * (0.05 + (1.0 - 0.05 * count) * rng.dirichlet(np.ones(count)))
        radii = np.exp(rng.uniform(math.log(0.03), 0.0, count))
        radii[(rng.uniform(size=count) < 0.25) & (count > 1)] = math.inf
        bend = float(np.sum(lengths / radii))
        if bend > 0.0 and 0.05 < K / bend < 0.3:
            sections = tuple(
                Section(float(a), float(b)) for a, b in zip(lengths, radii, strict=True)
            )
            return Sheath(sections, K / bend, EA)


def build_chain(sheath: Sheath) -> Chain:
    sections = []
    for section in sheath.sections:
        parts = max(1, math.ceil(sheath.friction * section.bend_angle / BEAD))
        sections += [(section.length / parts, section.radius)] * parts
    chain = Chain(sections, sheath.friction, sheath.axial_stiffness, beads=60, tension=0.05)
    chain.move(Force(LOW), HELD)
    return chain


def divide_leg(start: float, end: float) -> Array:
    near = start + (end - start) * 0.3 * np.linspace(0.0, 1.0, 50) ** 2
    T = np.unique(
        np.concatenate([np.geomspace(start, end, 150), np.linspace(start, end, 120), near])
    )
    return T if end > start else T[::-1]


def simulate_loop(
    sheath: Sheath, sigma: float, rng: np.random.Generator, peak: float, loops: int
) -> tuple[Array, Array]:
    chain = build_chain(sheath)
    T_in, q_p = [], []
    turns = [LOW, peak, *(LOW, peak) * loops]
    for number, (start, end) in enumerate(itertools.pairwise(turns)):
        seconds = OTHERS if number else FIRST
        T = divide_leg(start, end)
        q = np.array([chain.move(Force(t), HELD).travel[0] for t in T])
        order = np.argsort(q, kind="stable")
        at = np.linspace(q[0], q[-1], round(seconds * 1000))
        at = np.append(at, np.full(round(REST * 1000), at[-1]))
        T_in.append(np.interp(at, q[order], T[order]))
        q_p.append(at)
    T_all = np.concatenate(T_in)
    T_all = T_all + rng.normal(0.0, sigma, len(T_all))
    return T_all, np.round((np.concatenate(q_p) + rng.uniform(0.0, 0.01)) / COUNT) * COUNT


def simulate_motion(sheath: Sheath) -> tuple[Array, Array, Array]:
    chain = build_chain(sheath)
    T_in = np.concatenate([divide_leg(a, b)[::3] for a, b in itertools.pairwise(MOTION)])
    rows = []
    for T in T_in:
        chain.move(Force(T), HELD)
        rows.append((chain.T_out, chain.elongation))
    T_out, elongation = np.array(rows).T
    return T_in, T_out, elongation


def compute_errors(model: Sheath, truth: tuple[Array, Array, Array]) -> tuple[float, float]:
    T_in, T_out, elongation = truth
    table = build_tables(model)
    by_model = simulate_tensions(table, build_slack_profile(table), T_in)
    return (
        100.0 * float(np.abs(by_model[0] - T_out).max() / T_out.max()),
        100.0 * float(np.abs(by_model[1] - elongation).max() / elongation.max()),
    )


def fit_by_paper(result: Calibration, sheath: Sheath) -> Sheath:
    K = result.K_paper_ratio or result.K_paper
    return Sheath.uniform(K.value if K else 0.0, sheath.length, sheath.axial_stiffness)


def describe(number: int, sheath: Sheath) -> str:
    parts = ", ".join(
        f"{s.length * 1e3:.0f} mm "
        + ("straight" if math.isinf(s.radius) else f"R {s.radius * 1e3:.0f}")
        for s in sheath.sections
    )
    return f"{number}: K {sheath.K:.2f}, mu {sheath.friction:.2f}, {parts}"


def main() -> None:
    options = parse_options(
        __doc__,
        sheaths=(60, "number of them"),
        seed=(1, "of all"),
        peak=(20.0, "largest tension of the loop [N]"),
        loops=(1, "number of loops"),
    )
    rows = []
    for number in range(options.sheaths):
        rng = np.random.default_rng((options.seed, number))
        sheath = draw_sheath(rng)
        T_in, q_p = simulate_loop(sheath, rng.uniform(0.01, 0.03), rng, options.peak, options.loops)
        name = describe(number, sheath)
        try:
            result = calibrate(
                T_in, q_p, axial_stiffness=sheath.axial_stiffness, length=sheath.length
            )
        except CalibrationError as error:
            print(f"refused {name}: {error}")
            continue
        truth = simulate_motion(sheath)
        ours = compute_errors(result.build_sheath(sheath.length), truth)
        paper = compute_errors(fit_by_paper(result, sheath), truth)
        rows.append(Row(name, result.K.value - sheath.K, result.K.uncertainty, *ours, *paper))
    table = np.abs(np.array([row[1:] for row in rows]))
    print(f"{len(rows)} of {options.sheaths} sheaths, share of them with an error up to")
    names = ("K", "T_out %", "elong. %", "paper T_out %", "paper elong. %")
    print(f"{'':8}" + "".join(f"{name:>16}" for name in names))
    for share in SHARES:
        line = np.quantile(table[:, [0, 2, 3, 4, 5]], share, axis=0)
        print(f"{share:7.0%} {line[0]:16.4f}" + "".join(f"{value:16.2f}" for value in line[1:]))
    sure = float(np.mean(table[:, 0] < 2.0 * table[:, 1]))
    print(f"K within two stated standard uncertainties on {sure:.0%}")
    print("worst, by T_out:")
    for row in sorted(rows, key=lambda row: -row.T_out)[:4]:
        print(f"  {row.T_out:5.2f} %, K {row.K:+.3f} (u {row.uncertainty:.3f}), sheath {row.name}")
    print("worst of the paper's method, by T_out:")
    for row in sorted(rows, key=lambda row: -row.paper_tension)[:3]:
        print(f"  {row.paper_tension:5.1f} %, sheath {row.name}")


if __name__ == "__main__":
    main()
