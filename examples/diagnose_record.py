"""A diagnosis: a load cell at the tip that reads 15 % too much, found in the data.

    python examples/diagnose_record.py

The record is simulated, the effect put in by hand, and a few causes of the catalogue are compared.
"""

import estimator as est
from teleop import make_spring_bench, simulate

run = simulate(make_spring_bench(), "nested", duration=20.0, rate=50.0).tendon()
misread = run._replace(distal_tension=1.15 * run.distal_tension)
diagnosis = est.diagnose(misread, ["distal_tension_gain", "creep", "friction_step"])
print(est.summarise_result(diagnosis))
