"""What noise on T_in does to the estimated T_out, and what each treatment of it costs and gains.

python -m studies.noise_treatment

Simulated: a clean T_in gives the true T_out by the law, the same T_in with noise of 0.03 N goes
through the estimator with each treatment; bias and RMSE by what T_in does. Measured: the bench
record beside the project (or in TELEOP_SHARED_DATA), as it is and with noise added, against the tip
load cell. Takes 10 s.
"""

import math
import os
from pathlib import Path

import numpy as np

from estimator.array_types import Array
from estimator.calibration.identification import fit_bench
from estimator.law.displacement import push_displacement
from estimator.law.sheath import Sheath
from estimator.law.transmission import (
    build_slack_profile,
    build_tables,
    read_profile,
    simulate_tensions,
)
from estimator.noise_treatment import Treatment, estimate_noise_sigma
from estimator.online import online
from estimator.online.tendon_model import TendonModel
from studies.testbed.command import parse_options

SIGMA = 0.03  # [N]
TRAVEL_SIGMA = 1e-6  # [m]
SEEDS = 10
SHEATH = Sheath.uniform(1.0, 1.5, 9000.0)
# s, N: slack, slow pull, hold, slow release, hold, fast pull, fast reversals
KNOTS = np.array(
    [(0.0, 0.0), (2.0, 15.0), (4.0, 15.0), (6.0, 1.0), (8.0, 1.0), (8.4, 17.0), (8.8, 1.0),
     (9.2, 14.0), (9.5, 5.0), (9.8, 11.0), (10.2, 1.0), (11.0, 1.0)]
)  # fmt: skip


TREATMENTS = {
    "none": Treatment(0.0, 0.0),
    "dead band 1 sigma": Treatment(0.0, 1.0),
    "dead band 2 sigma": Treatment(0.0, 2.0),
    "dead band 3 sigma": Treatment(0.0, 3.0),
    "average 2 ms": Treatment(0.002, 0.0),
    "average 2 ms, dead band 1 sigma": Treatment(0.002, 1.0),
    "average 2 ms, dead band 2 sigma": Treatment(0.002, 2.0),
    "average 5 ms, dead band 2 sigma": Treatment(0.005, 2.0),
    "average 20 ms, dead band 2 sigma": Treatment(0.020, 2.0),
}


def apply_law(sheath: Sheath, T_in: Array) -> Array:
    table = build_tables(sheath)
    return simulate_tensions(table, build_slack_profile(table), np.ascontiguousarray(T_in))[0]


def estimate_tip(sheath: Sheath, time: Array, T_in: Array, sigma: float, how: Treatment) -> Array:
    """Return T_out by the estimator, from the tension alone."""
    model = TendonModel(sheath, tension_noise=sigma, treatment=how)
    return online.run(online.prepare(model), time, T_in).distal_tension


def estimate_from_travel(sheath: Sheath, q: Array) -> Array:
    """Return T_out with T_in taken from the travel, right only while the tip is blocked."""
    table = build_tables(sheath)
    profile = build_slack_profile(table)
    T_out = np.empty_like(q)
    for i, travel in enumerate(q):
        push_displacement(table, profile, travel, 0.0)
        T_out[i] = read_profile(table, profile)[1]
    return T_out


def print_simulated(rate: float) -> None:
    time = np.arange(0.0, KNOTS[-1, 0], 1.0 / rate)
    clean = np.interp(time, *KNOTS.T)
    truth = apply_law(SHEATH, clean)
    table = build_tables(SHEATH)
    travel = simulate_tensions(table, build_slack_profile(table), clean)[1]
    slope = np.gradient(clean, time)
    fast = time > KNOTS[4, 0]
    masks = {
        "pull": (slope > 0.5) & ~fast,
        "hold high": (slope == 0.0) & (clean > 10.0),
        "release": (slope < -0.5) & ~fast,
        "hold low": (slope == 0.0) & (clean < 2.0) & ~fast,
        "fast": fast,
    }
    print(f"\nsimulated, {rate:g} Hz, sigma {SIGMA} N, K {SHEATH.K:g}: bias / RMSE of T_out [mN]")
    print(f"{'':34}" + "".join(f"{name:>14}" for name in masks) + f"{'all':>8}")
    rng = np.random.default_rng(1)
    noisy = [clean + rng.normal(0.0, SIGMA, len(time)) for _ in range(SEEDS)]
    rows = {
        name: [estimate_tip(SHEATH, time, T, SIGMA, how) for T in noisy]
        for name, how in TREATMENTS.items()
    }
    rows["driven by travel (tip blocked)"] = [
        estimate_from_travel(SHEATH, travel + rng.normal(0.0, TRAVEL_SIGMA, len(time)))
        for _ in noisy
    ]
    for name, results in rows.items():
        error = np.array(results) - truth
        line = f"{name:34}"
        for mask in masks.values():
            part = 1e3 * error[:, mask]
            line += f"{part.mean():+7.0f} /{math.sqrt(np.mean(part**2)):5.0f}"
        print(line + f"{1e3 * math.sqrt(np.mean(error**2)):8.0f}")


def print_measured() -> None:
    root = os.environ.get("TELEOP_SHARED_DATA")
    folder = Path(root) if root else Path(__file__).resolve().parents[2] / "shared" / "data"
    file = folder / "sheath-bench" / "session1.csv"
    if not file.exists():
        print(f"\nmeasured: skipped, no {file}")
        return
    time, T_in, T_out = np.genfromtxt(file, delimiter=",", skip_header=1).T.copy()
    fit = fit_bench(T_in, T_out)
    sheath = Sheath.uniform(fit.parameters["K"].value, 1.0, 9000.0)
    own = estimate_noise_sigma(T_in[time < 4.0])
    rng = np.random.default_rng(2)
    added = [T_in + rng.normal(0.0, SIGMA, len(time)) for _ in range(SEEDS)]
    clean = apply_law(sheath, T_in)
    print(f"\nmeasured, 82 Hz, K {sheath.K:.3f} fitted untreated, own noise {own:.4f} N: RMSE [mN]")
    print(f"{'':34}{'as measured':>14}{'0.03 N added':>14}{'change by the noise':>22}")
    for name, how in TREATMENTS.items():
        plain = estimate_tip(sheath, time, T_in, own, how)
        sigma = math.hypot(own, SIGMA)
        noisy = np.array([estimate_tip(sheath, time, T, sigma, how) for T in added])
        rmse = [math.sqrt(np.mean(e**2)) for e in (plain - T_out, noisy - T_out, noisy - clean)]
        print(f"{name:34}{1e3 * rmse[0]:14.0f}{1e3 * rmse[1]:14.0f}{1e3 * rmse[2]:22.0f}")


if __name__ == "__main__":
    parse_options(__doc__)
    print_simulated(1000.0)
    print_simulated(82.0)
    print_measured()
