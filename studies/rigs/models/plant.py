"""What the motors of a bus model pull at, in counts of the bus."""

import numpy as np

COUNTS = 4096.0  # a turn of a motor's shaft
RADIUS = 0.010  # [m] of the pulleys
METRES = 2.0 * np.pi * RADIUS / COUNTS  # a count
NEWTONS = 0.001  # a count of the cells
ZERO = 2048.0  # [counts] where the displacement is 0


class Springs:
    """One spring at each motor, which follows its target in 5 ms; slack below zero."""

    STIFFNESS = 2000.0  # [N/m]
    LAG_S = 0.005

    def __init__(self, motors: int) -> None:
        self.position = np.full(motors, ZERO)  # [counts]
        self._time_s = 0.0
        self._random = np.random.default_rng(1)

    def advance(self, time_s: float, target, powered, load_max=np.inf) -> None:
        """Move to session time `time_s` [s]; motors without power stay where they are.

        A motor with power does not pull at more than `load_max` [counts of the cells].
        """
        dt, self._time_s = max(0.0, time_s - self._time_s), time_s
        share = min(1.0, dt / self.LAG_S) * np.asarray(powered, float)
        moved = self.position + share * (np.asarray(target, float) - self.position)
        tension_max = np.asarray(load_max, float) * NEWTONS - 1.0
        stalled = ZERO + tension_max / (METRES * self.STIFFNESS)
        self.position = np.where(powered, np.minimum(moved, stalled), moved)

    def read_cells(self):
        tension = np.maximum((self.position - ZERO) * METRES * self.STIFFNESS, 0.0)
        noise = self._random.normal(0.0, 0.01, len(tension))
        return np.round((1.0 + tension + noise) / NEWTONS)


class Tendons:
    """The simulated rig of the project behind the motors: sheaths, friction, joints with stops."""

    def __init__(self, joints: int, paired: bool = True) -> None:
        from slave.rigs.simulated import (
            JointConfig,
            SimulatedRig,
            SimulatedRigConfig,
            TendonPlantConfig,
        )
        from slave.simulation.environment import FreeConfig
        from slave.simulation.joint import BodyConfig

        tendons = (TendonPlantConfig(),) * (2 if paired else 1)
        # a tendon must reach its stop well below the tension of a calibration
        single = BodyConfig(spring=60.0, stops=(-0.002, 0.030))
        body = BodyConfig(stops=(-0.018, 0.018)) if paired else single
        joint = JointConfig(tendons=tendons, body=body, environment=FreeConfig())
        self._rig = SimulatedRig(SimulatedRigConfig(joints=(joint,) * joints))
        self._sample = self._rig.read(0.0)[0]
        self._held = self._sample.proximal_displacement.copy()

    @property
    def position(self):
        return self._sample.proximal_displacement / METRES + ZERO

    def advance(self, time_s: float, target, powered, load_max=np.inf) -> None:
        """Move to session time `time_s` [s]; motors without power hold, as a gear does.

        A motor whose tension is above `load_max` [counts of the cells] pulls in no further.
        """
        wanted = (np.asarray(target, float) - ZERO) * METRES
        wanted = np.where(self.read_cells() > load_max, np.minimum(wanted, self._held), wanted)
        self._held = np.where(powered, wanted, self._held)
        self._rig.write(self._held)
        for sample in self._rig.read(time_s):
            self._sample = sample

    def read_cells(self):
        return np.round(self._sample.proximal_tension / NEWTONS)
