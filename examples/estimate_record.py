"""The estimator on a record: fit the sheath on one half, estimate the tip on the other.

    python examples/estimate_record.py [bench.csv]

Without a file the simulated rig of configs/paper-joint.yaml makes one.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import estimator as est
from teleop.cli import commands
from teleop.data import read_table

path = sys.argv[1] if len(sys.argv) > 1 else Path(tempfile.mkdtemp()) / "bench.csv"
if len(sys.argv) == 1:  # a tip on a spring, as on a calibration bench
    spring = "slave.rig.joints=[{tendons: [{sheath: {sections: [{length: 1.5, radius: 0.3}]}}], "
    spring += "body: {spring: 2000, pretension: 0}, environment: {type: free}}]"
    words = ["--profile", "nested", "--duration", "20", "--rate", "200", "--set", spring]
    commands.main(["simulate", "--out", str(path), *words])

run = read_table(path)
half = len(run.time) // 2
first = est.Samples(run.time[:half], run.proximal_tension[:half], None, run.distal_tension[:half])
fit = est.fit_sheath(first, length=1.5)
print(f"K = {fit.K.value:.3f} ({fit.K.low:.3f} to {fit.K.high:.3f}): {fit.reason}")

tip = est.Estimator(fit.model).run(run)
error = (tip.tension - run.distal_tension)[half:]
inside = (tip.low <= run.distal_tension) & (run.distal_tension <= tip.high)
print(f"tension at the tip: RMSE {np.sqrt(np.mean(error**2)):.3f} N on the other half,")
print(f"{inside[half:].mean():.0%} of it inside the interval")
