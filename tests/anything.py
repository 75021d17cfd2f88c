"""Numbers of every kind, quickly: what gates must stand in runs that are too long for hypothesis.

GATE_CASES=1000000 in the environment makes as many cases of each such run.
"""

import math
import os
import random
import struct

CASES = int(os.environ.get("GATE_CASES", "10000"))
ODD = (
    *(0.0, -0.0, math.nan, math.inf, -math.inf, 5e-324, -5e-324, 2.3e-308, 1.8e308, -1.8e308),
    *(1e-9, -1e-9, 1e9, -1e9, 1e300, -1e300),
)


class Anything:
    """Draws from ordinary values, odd ones, and every bit pattern there is; by seed."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)  # noqa: S311

    def number(self, low: float, high: float) -> float:
        """Return a number: most often one of `low ... high`."""
        dice = self.random.random()
        if dice < 0.7:
            return self.random.uniform(low, high)
        if dice < 0.85:
            return self.random.choice(ODD)
        return float(struct.unpack("<d", self.random.randbytes(8))[0])

    def flag(self, share: float = 0.5) -> bool:
        return self.random.random() < share
