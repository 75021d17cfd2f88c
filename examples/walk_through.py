# %% [markdown]
# From data to verdict: a bench record is fitted, estimated from, diagnosed, and the model extended.
# Open it in an editor with cells (VS Code, Spyder, jupytext), or run it as it is.

# %%
import numpy as np

import estimator as est
from slave.simulation.effects.friction import FrictionStep
from teleop import make_spring_bench, simulate

# %% [markdown]
# ## 1. Data
# A simulated calibration bench: the tip pulls a spring, load cells and encoders at both ends. The
# friction of this rig rises by 30 % at 12 s, which nobody tells the model.

# %%
bench = make_spring_bench(effects=[FrictionStep(change=0.3, start=12.0)])
run = simulate(bench, "nested", duration=24.0, rate=50.0).tendon()

# %% [markdown]
# ## 2. The plain law
# One friction for the whole record. The interval of K comes from the scatter of the residual.

# %%
fit = est.fit_sheath(run, length=1.5)
print(f"K = {fit.K.value:.3f} ({fit.K.low:.3f} to {fit.K.high:.3f}); accepted: {fit.accept}")
tip = est.Estimator(fit.model).run(run)
error = tip.tension - run.distal_tension
print(f"RMSE {np.sqrt(np.mean(error**2)):.3f} N; first half {error[:600].std():.3f} N, "
      f"second half {error[600:].std():.3f} N")  # fmt: skip

# %% [markdown]
# ## 3. The diagnosis
# Each cause of the catalogue is fitted, and compared on samples that were held out. A few names
# here; leave them out to search them all.

# %%
diagnosis = est.diagnose(run, ["friction_step", "friction_drift", "creep", "distal_tension_gain"])
print(est.summarise_result(diagnosis))

# %% [markdown]
# ## 4. The verdict
# A cause, its size with a 95 % interval, and the share of the error that modelling it removes.

# %%
print(f"\nverdict: {diagnosis.verdict}, causes: {', '.join(diagnosis.causes)}")
for channel, gain in diagnosis.gain.items():
    print(
        f"{channel}: held-out error falls by {gain.value:.0%} ({gain.low:.0%} to {gain.high:.0%})"
    )
