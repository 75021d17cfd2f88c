"""A diagnosis: a load cell at the tip that reads 15 % too much, found in the data.

    python examples/diagnose_record.py

The record is simulated, the effect put in by hand, and a few causes of the catalogue are compared.
"""

import tempfile
from pathlib import Path

import estimator as est
from teleop.cli import commands
from teleop.data import read_table

path = Path(tempfile.mkdtemp()) / "bench.csv"
spring = "slave.rig.joints=[{tendons: [{sheath: {sections: [{length: 1.5, radius: 0.3}]}}], "
spring += "body: {spring: 2000, pretension: 0}, environment: {type: free}}]"
words = ["--profile", "nested", "--duration", "20", "--rate", "100", "--set", spring]
commands.main(["simulate", "--out", str(path), *words])

run = read_table(path)
wrong = est.Samples(
    run.time,
    run.proximal_tension,
    run.proximal_displacement,
    1.15 * run.distal_tension,
    run.distal_displacement,
)
found = est.diagnose(wrong, ["distal_tension_gain", "creep", "friction_step"])
print(est.summarise_result(found))
