"""What the simulated plant costs: one step by number of nodes, and a rig against real time.

python benchmarks/plant.py

Beside a step stand, from the same run: a call of a compiled function that does nothing with the
same arguments, which every step contains; and one solution of a tridiagonal system of the chain's
size by LAPACK, of which an iterating solver would need several.
"""

import time
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from estimator.compiled import compiled
from slave.motion import Scale, Turns
from slave.plant.chain import Chain, SheathConfig, build_chain, settle
from slave.plant.load import Load, TipConfig, build_load
from slave.rigs.simulated import JointConfig, SimulatedRigConfig
from slave.simulate import simulate

NODES = (10, 30, 60, 120, 300)
STEPS = 3000


@compiled
def nothing(chain: Chain, load: Load, before: NDArray[np.float64], motor: float) -> float:
    """Only be called."""
    return float(chain.pretension + load.spring + before[0] + motor)


def best_of(run: Callable[[], object], calls: int, rounds: int = 5) -> float:
    """Return the fastest of some rounds, in microseconds a call."""
    run()
    times = []
    for _ in range(rounds):
        begin = time.perf_counter()
        run()
        times.append(time.perf_counter() - begin)
    return min(times) / calls * 1e6


def main() -> None:
    wave = 6e-3 * (1.0 - np.cos(np.linspace(0.0, 6.0 * np.pi, STEPS)))
    path = (wave * (1.0 + 0.3 * np.sin(np.linspace(0.0, 40.0, STEPS)))).tolist()
    load = build_load(TipConfig())
    print(
        f"{'nodes':>6} {'step [us]':>10} {'bare call [us]':>15} {'one tridiagonal solve [us]':>27}"
    )
    for nodes in NODES:
        chain = build_chain(SheathConfig(nodes=nodes), 1.0)

        def steps(chain: Chain = chain, nodes: int = nodes) -> None:
            state = np.zeros(nodes + 2)
            for motor in path:
                state = settle(chain, load, state, motor)

        def calls(chain: Chain = chain, nodes: int = nodes) -> None:
            state = np.zeros(nodes + 2)
            for motor in path:
                nothing(chain, load, state, motor)

        def solves(nodes: int = nodes) -> None:
            side, middle, right = np.full(nodes, -1.0), np.full(nodes + 1, 2.1), np.ones(nodes + 1)
            for _ in range(STEPS):
                lapack.dgtsv(side, middle, side, right)

        step, call, solve = (best_of(f, STEPS) for f in (steps, calls, solves))
        print(f"{nodes:>6} {step:>10.1f} {call:>15.1f} {solve:>27.1f}")

    print(f"\n{'joints':>6} {'x real time':>12}   (a rig with sensors, 1 kHz, 60 nodes a tendon)")
    motion = Turns((20.0, 5.0), Scale().speed)
    for joints in (1, 2, 4, 8):
        config = SimulatedRigConfig(joints=(JointConfig(),) * joints)
        took = best_of(partial(simulate, config, motion, 5.0, 1000.0), 1, 2) * 1e-6
        print(f"{joints:>6} {5.0 / took:>12.0f}")


if __name__ == "__main__":
    main()
