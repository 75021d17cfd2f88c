"""What a procedure measured: samples, with the state of each joint's procedure."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from slave.calibration.posture import JointTravels
from slave.calibration.procedure_state import ProcedureState, StopContact
from slave.rig import RigSample, collect_loop_tensions

Codes = NDArray[np.int64]


@dataclass(frozen=True)
class ProcedureData:
    """Measurements and phases of a procedure: n samples, t tendons, j joints.

    A joint that was not calibrated has no stops.
    """

    joints: tuple[tuple[int, ...], ...]  # the tendons of each
    time: Array  # [s] shape (n,), on the rig's clock
    tension: Array  # [N] shape (n, t)
    travel: Array  # [m] shape (n, t), less what the joints that a tendon passes move it
    joint_travel: Array  # [m] shape (n, j), of joints that share tendons; else zero
    stage: Codes  # shape (n,): running number
    phase: Codes  # shape (n, j)
    side: Codes  # shape (n, j): which tendon of the joint was pulled, 2 and 3 in drags
    releases: Codes  # shape (n, j): ended on that side
    stops: tuple[tuple[StopContact, ...], ...]  # of each joint, one a tendon
    loop_tension: Array | None  # [N] at both ends of sensing loops, shape (2, n, t)


@dataclass
class ProcedureLog:
    """Samples with the state of each joint's procedure."""

    samples: list[RigSample] = field(default_factory=list)
    codes: list[tuple[tuple[int, int, int], ...]] = field(default_factory=list)
    stages: list[int] = field(default_factory=list)
    joint_travel: list[Array] = field(default_factory=list)

    def add(
        self,
        samples: Sequence[RigSample],
        memories: Sequence[ProcedureState],
        stage: int,
        joint_travel: Array,
    ) -> None:
        """Append the samples of a tick."""
        now = tuple((int(m.phase), m.side, m.releases) for m in memories)
        self.samples += samples
        self.codes += [now] * len(samples)
        self.stages += [stage] * len(samples)
        self.joint_travel += [joint_travel.copy()] * len(samples)

    def record(
        self,
        joints: tuple[tuple[int, ...], ...],
        stops: Sequence[tuple[StopContact, ...]],
        travels: JointTravels,
    ) -> ProcedureData:
        """Return the log as arrays."""
        codes = np.array(self.codes, dtype=np.int64)
        joint_travel = np.array(self.joint_travel)
        travel = np.array([s.proximal_displacement for s in self.samples])
        return ProcedureData(
            joints=joints,
            time=np.array([s.time_s for s in self.samples]),
            tension=np.array([s.proximal_tension for s in self.samples]),
            travel=travel - travels.get_passing_travel(joint_travel),
            joint_travel=joint_travel,
            stage=np.array(self.stages, dtype=np.int64),
            phase=codes[:, :, 0],
            side=codes[:, :, 1],
            releases=codes[:, :, 2],
            stops=tuple(stops),
            loop_tension=collect_loop_tensions(self.samples),
        )
