"""The transmission law: pull and release at the housing, and what arrives at the tip.

    python examples/law_loop.py [loop.png]

Friction makes the tip follow with a loop: after a reversal its tension stays until the housing has
come back by exp(2K), K being the friction of the whole sheath.
"""

import sys

import numpy as np

import estimator as est

sheath = est.Sheath.uniform(K=0.8, length=1.5, axial_stiffness=9000.0)
pull = np.concatenate([np.linspace(0, 20, 500), np.linspace(20, 2, 500), np.linspace(2, 15, 500)])
law = est.simulate(sheath, pull)

peak = pull.argmax()
held = pull[peak:][law.distal_tension[peak:] > law.distal_tension[peak] - 1e-9].min()
print(f"20 N at the housing are {law.distal_tension[peak]:.2f} N at the tip (20 exp(-K))")
print(f"the tip holds them until the housing has come back to {held:.2f} N (20 exp(-2K))")

if len(sys.argv) > 1:
    import matplotlib as mpl
    from matplotlib import pyplot as plt

    mpl.use("Agg")
    plt.plot(pull, law.distal_tension)
    plt.xlabel("tension at the housing [N]")
    plt.ylabel("tension at the tip [N]")
    plt.savefig(sys.argv[1])
    print(f"written: {sys.argv[1]}")
