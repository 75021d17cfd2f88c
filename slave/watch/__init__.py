"""The fault watch: broken and jammed tendons, sensors that no longer measure, motors gone astray.

`step` looks at every sample, whether engaged or not, `watch_motors` at every tick.
docs/control.md has thresholds and times.
"""

from slave.watch.config import WatchConfig
from slave.watch.motor import Motors, watch_motors
from slave.watch.sample import Finding, Watch, start, step

__all__ = ["Finding", "Motors", "Watch", "WatchConfig", "start", "step", "watch_motors"]
