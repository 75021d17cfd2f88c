"""The estimator on a record: fit the sheath on one half, estimate the tip on the other.

    python examples/estimate_record.py [bench.csv]

Without a file a simulated bench makes the record.
"""

import sys

import numpy as np

import estimator as est
from teleop import make_spring_bench, simulate
from teleop.data import read_table

if len(sys.argv) > 1:
    run = read_table(sys.argv[1])
else:
    run = simulate(make_spring_bench(), "nested", duration=20.0, rate=200.0).tendon()

half = len(run.time) // 2
first = est.Samples(run.time[:half], run.proximal_tension[:half], None, run.distal_tension[:half])
fit = est.fit_sheath(first, length=1.5)
print(f"K = {fit.K.value:.3f} ({fit.K.low:.3f} to {fit.K.high:.3f}): {fit.reason}")

tip = est.Estimator(fit.model).run(run)
error = (tip.tension - run.distal_tension)[half:]
inside = (tip.low <= run.distal_tension) & (run.distal_tension <= tip.high)
print(f"tension at the tip: RMSE {np.sqrt(np.mean(error**2)):.3f} N on the other half,")
print(f"{inside[half:].mean():.0%} of it inside the interval")
