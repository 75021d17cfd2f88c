"""The fault watch: tendons that are broken or jammed, load cells that no longer measure.

`step` looks at every sample, whether engaged or not. docs/control.md has thresholds and times.
"""

from slave.watch.config import WatchConfig
from slave.watch.sample import Finding, Watch, start, step

__all__ = ["Finding", "Watch", "WatchConfig", "start", "step"]
