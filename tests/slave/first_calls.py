"""What is compiled, or loaded compiled, for the first time after the warm-up of a program.

  python -m tests.slave.first_calls PROGRAM     its last line names such functions

Run in a process of its own: other tests have called everything before.
"""

import sys
from contextlib import ExitStack

import numpy as np

from slave.bring_up import rig_check
from slave.calibration import procedure_run as calibration_run
from slave.calibration.config import InitialiseConfig
from slave.gate import GateConfig
from slave.rig import RigSample

TICKS = 300  # of a session; it is engaged after 50


class Pair(calibration_run.StationaryRig):
    """A joint of two tendons; its encoders tell where the motors are, which take time to follow."""

    tendons, joints, starts_at_zero, follows = 2, ((0, 1),), False, False

    def __init__(self):
        self.position, self.writes = np.array([0.004, -0.001]), 0

    def read(self, time_s):
        tension = np.maximum(1.0 + 2000.0 * (self.position - [0.004, -0.001]), 0.0)
        return (RigSample(time_s, tension, self.position.copy()),)

    def write(self, proximal_displacement):
        self.position, self.writes = proximal_displacement.copy(), self.writes + 1
        self.follows = self.writes > 5


def check():
    """`teleop rig check`, of which `warm_up` is called before the rig is opened."""
    rig_check.warm_up()
    yield
    ticks = calibration_run.generate_fast_ticks(500.0)
    rig = Pair()
    rest = rig_check.measure_at_rest(rig, ticks, 0, 0.1)
    mover = rig_check.GatedRig(rig, GateConfig(), ticks, 0, rest)
    mover.enable()
    rig_check.evaluate_move(
        rig_check.move_motor(mover, rest, 1, rig_check.MotorMove(0.5e-3, 2.0)), rest
    )


def calibrate():
    """`teleop calibrate`, and a slave that calibrates at its start."""
    calibration_run.warm_up()
    yield
    limits = calibration_run.ProcedureLimits(InitialiseConfig(), GateConfig())
    driven = calibration_run._ProcedureRun(Pair(), limits, (0,), together=False)
    for tick in calibration_run.generate_fast_ticks(500.0):
        driven.tick(tick.stamp_ns * 1e-9, tick.dt, "enough" if tick.index > 2000 else "")
        if driven.over:
            break


def session():
    """Both sides of a session, from their warm-up to an engaged loop."""
    from master import process as master_process
    from slave.config import SlaveConfig
    from slave.warm_up import compile_session
    from teleop.config.loading import load
    from tests.tick.session import ARM, Session

    compile_session(load(ARM, SlaveConfig, "slave", ()), with_dynamics=False)
    master_process.warm_up()
    yield
    with ExitStack() as stack:
        both = Session(stack)
        for _ in range(TICKS):
            both.tick()
        assert any(both.slave.memory.gated_position), "never engaged"


def versions():
    """Return how many versions of each compiled function are there."""
    return {
        f"{function.__module__}.{function.__name__}": len(function.overloads)
        for module in list(sys.modules.values())
        for function in vars(module).values()
        if type(function).__name__ == "EntryDispatcher"
    }


def extensions():
    """A session with extensions, which have their parts of the tick compiled as they are opened."""
    from master import process as master_process
    from slave.config import SlaveConfig
    from slave.warm_up import compile_session
    from teleop.config.extensions import allow_imports
    from teleop.config.loading import load
    from tests.root import ROOT
    from tests.tick.session import HAND_ENGAGED, Session

    sys.path.insert(0, str(ROOT / "examples" / "own_package" / "src"))
    allow_imports()
    file, settings = (
        ROOT / "configs" / "bowden.yaml",
        (
            "slave.estimator.type=mylab.estimator:CapstanConfig",
            "slave.controller.type=mylab.controller:FloorConfig",
            "coupling={type: 'mylab.coupling:LagConfig'}",
        ),
    )
    compile_session(load(file, SlaveConfig, "slave", settings), with_dynamics=False)
    master_process.warm_up()
    with ExitStack() as stack:
        both = Session(stack, (*HAND_ENGAGED, *settings), file=file)
        yield
        for _ in range(TICKS):
            both.tick()
        assert any(both.slave.memory.gated_position), "never engaged"


PROGRAMS = {
    "check": check,
    "calibrate": calibrate,
    "session": session,
    "extensions": extensions,
}

if __name__ == "__main__":
    program = PROGRAMS[sys.argv[1]]()
    next(program)
    before = versions()
    for _ in program:
        pass
    new = [name for name, count in versions().items() if count > before.get(name, 0)]
    print("first calls:", *new)
