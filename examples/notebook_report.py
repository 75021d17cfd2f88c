"""A diagnosis as a notebook shows it: fitted to one record, validated with another.

    python examples/notebook_report.py report.html

In a notebook, `est.show_result(found)` at the end of a cell shows the same.
"""

import sys
import tempfile
from pathlib import Path

import estimator as est
from teleop.cli import commands
from teleop.data import read_table

folder = Path(tempfile.mkdtemp())
spring = "slave.rig.joints=[{tendons: [{sheath: {sections: [{length: 1.5, radius: 0.3}]}}], "
spring += "body: {spring: 2000, pretension: 0}, environment: {type: free}}]"
wrong_gain = "slave.rig.effects=[{type: distal_tension_gain, gain: 0.15}]"
words = ["--profile", "nested", "--duration", "20", "--rate", "50", "--set", spring]
for name, speed in (("monday.csv", "0.003"), ("tuesday.csv", "0.004")):
    out = ["--out", str(folder / name), "--speed", speed]
    commands.main(["simulate", *out, *words, "--set", wrong_gain])

found = est.diagnose(
    read_table(folder / "monday.csv"),
    ["distal_tension_gain", "creep"],
    validate=[read_table(folder / "tuesday.csv")],
)
for file in found.forces:
    kind = "validation" if file.validation else "fitted"
    print(f"{kind}: force off by {file.before.rmse:.3f} N before, {file.after.rmse:.3f} N after")
est.plot_result(found).savefig(folder / "monday.svg")
if len(sys.argv) > 1:
    Path(sys.argv[1]).write_text(est.show_result(found).html)
