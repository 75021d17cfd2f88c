"""A diagnosis as a notebook shows it: fitted to one record, validated with another.

    python examples/notebook_report.py report.html

In a notebook, `est.show_result(diagnosis)` at the end of a cell shows the same.
"""

import sys
from pathlib import Path

import estimator as est
from slave.simulation.effects.sensors import DistalTensionGain
from teleop import MotionScale, make_spring_bench, simulate

bench = make_spring_bench(effects=[DistalTensionGain(gain=0.15)])
monday, tuesday = (
    simulate(bench, "nested", duration=20.0, rate=50.0, scale=MotionScale(speed=speed)).tendon()
    for speed in (0.003, 0.004)
)
diagnosis = est.diagnose(monday, ["distal_tension_gain", "creep"], validate=[tuesday])
for file in diagnosis.forces:
    kind = "validation" if file.validation else "fitted"
    print(f"{kind}: force off by {file.before.rmse:.3f} N before, {file.after.rmse:.3f} N after")
est.plot_result(diagnosis).savefig("monday.svg")
if len(sys.argv) > 1:
    Path(sys.argv[1]).write_text(est.show_result(diagnosis).html)
