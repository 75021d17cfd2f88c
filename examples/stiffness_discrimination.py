"""How much stiffer must tissue be to feel stiffer? Each trial shows two, in random order.

    python examples/stiffness_discrimination.py [--session] [FOLDER]

The observer is simulated, and its threshold hidden in it; `KeyObserver(design)` asks a person.
With --session each trial takes place in a session with a simulated robot.
"""

import sys
import tempfile

import numpy as np

from teleop import BayesianAdaptive, Design, Experiment, fit_psychometric, read_trials
from teleop import run_experiment as run

THRESHOLD, SPREAD = 0.15, 0.08  # hidden: the gain in stiffness found in 3 of 4 trials

words = [word for word in sys.argv[1:] if word != "--session"]
folder = words[0] if words else tempfile.mkdtemp(prefix="stiffness-")
rng = np.random.default_rng(1)
design = Design(
    procedure=BayesianAdaptive(
        stimuli=np.linspace(0.0, 0.6, 31),
        thresholds=np.linspace(0.02, 0.5, 33),
        spreads=np.geomspace(0.02, 0.3, 10),
        trials=80,
    ),
    intervals=2,
)


def set_stimulus(trial, interval):  # more force at the same depth is a stiffer tissue
    return {"force.scale": 0.2 * (1.0 + trial.stimulus * (interval == trial.target))}


def answer(trial):
    """Answer as a person would who feels the gain with an error, and sometimes lapses."""
    feels = rng.normal(trial.stimulus, SPREAD) > THRESHOLD and rng.random() > 0.02
    guess = int(rng.integers(1, 3))
    return str(trial.target if feels else guess)


experiment = Experiment(name="stiffness", design=design, set_stimulus=set_stimulus, duration=2.0)
config = "configs/demo.yaml" if "--session" in sys.argv else None
table = run(config, experiment, participant=1, out=folder, observer=answer)
rows = read_trials(table)
stimuli = [float(row["stimulus"]) for row in rows]
fit = fit_psychometric(stimuli, [row["correct"] == "1" for row in rows], guess_rate=0.5)
print(f"{len(rows)} trials in {table}")
print(f"threshold {fit.threshold:.3f}, 95 % interval {fit.low:.3f} to {fit.high:.3f}")
