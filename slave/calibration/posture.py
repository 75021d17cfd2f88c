"""The stages of calibrating joints that share tendons, and how the other joints follow.

A tendon pulled against the stop of its joint loads every joint that it passes (`arms.radii`). They
are held at the stops onto which it presses them: then motor travel is elongation, as with a single
joint, and the guides, behind the sheath, do not slide. Drags are repeated while fewer and fewer of
them are bent, from the tip on, the others in mid-range: friction at guides follows from the change.
Tendons that pass the moving joint travel with it and are kept just taut.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from estimator.array_types import Array
from slave.calibration.config import InitialiseConfig
from slave.calibration.phases import (
    DEAD_BAND_HIGH,
    TAUT_RATIO,
    TENSION_GAIN,
    compute_holding_speed,
)
from slave.calibration.procedure_state import Phase, ProcedureState
from teleop.errors import UsageError

JointTendons = Sequence[Sequence[int]]

DRAG_REACH = 0.8  # of the half range, each way: where drags of joints that pass others end
HOLD_RATIO = 0.4  # of the target tension: what holds a joint at its stop
SEEK_TENSION = 3.0  # [N] from which on it may be at its stop
STRAIN_RATIO = 4.0  # times the take-up tension: a following pair is paid out above it
SMOOTH_S = 0.005  # [s] of the followers' tensions


class Stage(NamedTuple):
    """What some joints do until each of them holds or has ended; the others hold or follow."""

    joints: tuple[int, ...]  # from 0
    phase: Phase | None = None  # they begin with; None: the whole procedure of a joint by itself
    side: int = 0  # which tendon is pulled
    target: float = 0.0  # of a move or drag: part of the half range from its middle, 1: the stop


def plan_stages(
    ratio: Array, joints: JointTendons, chosen: Sequence[int], drags: int, together: bool
) -> list[Stage]:
    """Return the stages in which the `chosen` joints are calibrated.

    `ratio`, shape (n, n), is the travel of the tendons of joint k over that of joint j; `joints`
    are the tendons of each. `UsageError` if the routing does not allow it, or a passed joint is not
    chosen.
    """
    if not (ratio - np.diag(np.diag(ratio))).any():
        return [Stage(tuple(chosen))] if together else [Stage((j,)) for j in chosen]
    if together:
        raise UsageError("--together: these joints share tendons (arms); leave it out")
    if np.triu(ratio, 1).any():
        raise UsageError("arms.radii: tendons must pass joints before their own only; renumber")
    everyone = tuple(range(len(joints)))
    stages, place = [Stage(everyone, Phase.TAKE_UP)], [0.0] * len(joints)
    for m in chosen:
        passed = [int(j) for j in np.flatnonzero(ratio[m, :m])]
        for j in passed:
            if len(joints[j]) == 1:
                raise UsageError(
                    f"arms: joint {j + 1} has a single tendon and cannot be held at both stops, "
                    f"as calibrating joint {m + 1} needs: fit that sheath with its tip blocked "
                    "(teleop estimate DATA --fit --save FILE)"
                )
            if j not in chosen:
                raise UsageError(
                    f"--joint {m + 1}: its tendons pass joint {j + 1}, whose stops it needs: add "
                    f"--joint {j + 1}"
                )
        for side in range(len(joints[m])):
            stages += _bend(passed, np.sign(ratio[m]) * (1 - 2 * side), place)
            stages.append(Stage((m,), Phase.SEEK, side))
            place[m] = 1.0 - 2.0 * side
            if passed and len(joints[m]) > 1:  # on its stop it would hold the joints that it passes
                stages.append(_move(m, 0.0, place))
        if len(joints[m]) == 1:
            place[m] = 0.0
            stages += _bend(passed, np.zeros(len(joints)), place)
            continue
        for count in range(len(passed), -1, -1):
            for side in range(drags):
                bent = np.sign(ratio[m]) * (1 - 2 * side)
                bent[passed[count:]] = 0.0
                stages += _bend(passed, bent, place)
                end = DRAG_REACH * (1 - 2 * side)
                if place[m] * end >= 0.0:
                    stages.append(_move(m, -end, place))
                stages.append(Stage((m,), Phase.DRAG, 2 + side, end))
                place[m] = end
        stages.append(_move(m, 0.0, place))
    return [*stages, Stage(everyone, Phase.SETTLE)]


def _bend(passed: Sequence[int], wanted: Array, place: list[float]) -> list[Stage]:
    """Return the moves of passed joints to `wanted`; those behind are straight meanwhile."""
    changed = [i for i, j in enumerate(passed) if place[j] != wanted[j]]
    if not changed:
        return []
    rest = passed[changed[0] :]
    straight = [_move(j, 0.0, place) for j in reversed(rest[1:]) if place[j] != 0.0]
    return straight + [_move(j, float(wanted[j]), place) for j in rest if place[j] != wanted[j]]


def _move(j: int, target: float, place: list[float]) -> Stage:
    side = int(target < place[j])
    place[j] = target
    return Stage((j,), Phase.MOVE, side, target)


class JointTravels:
    """Travel of joints that share tendons, from their motors, and what follows for the others.

    `compliance` [m/N] of each tendon is used until it is measured.

    Attributes
    ----------
    travel : array
        [m] Of each joint, shape (n,); it changes while the joint itself moves.
    stops : array
        [m] Of each joint, shape (n, 2): at the stop of its tendon b and of a; NaN until found.
    """

    def __init__(self, ratio: Array, joints: JointTendons, compliance: Sequence[float]) -> None:
        self.travel, self.stops = np.zeros(len(joints)), np.full((len(joints), 2), np.nan)
        self._passing = ratio - np.diag(np.diag(ratio))
        self._joints, self._before = joints, self.travel.copy()
        self._compliance, self._slack = compliance, np.zeros(len(joints))
        self._smooth: Array | None = None

    def get_passing_travel(self, travel: Array) -> Array:
        """Return what passed joints move each tendon [m], shape (..., tendons)."""
        by_joint = travel @ self._passing.T
        signs = [
            (k, 1 - 2 * side) for k, row in enumerate(self._joints) for side in range(len(row))
        ]
        return np.stack([sign * by_joint[..., k] for k, sign in signs], axis=-1)

    def set_home(self, memories: Sequence[ProcedureState], reading: Array) -> None:
        """Take the `reading` [m] of all motors as that of joints at zero and taut tendons."""
        for j, tendons in enumerate(self._joints):
            ends = self._compute_ends(j, memories[j], reading)
            self._slack[j] = sum(ends) / len(tendons)

    def update(
        self, config: InitialiseConfig, j: int, memory: ProcedureState, reading: Array
    ) -> None:
        """Take the `reading` [m] of all motors while joint `j` may move.

        The less a tendon is stretched, the better it tells; one that is slack tells nothing.
        """
        if len(memory.tension) == 1 or memory.phase not in (Phase.SEEK, Phase.MOVE, Phase.DRAG):
            return  # no tendon passes a joint of a single one
        T = np.array(memory.tension)
        weights = np.where(TAUT_RATIO * config.keep < T, 1.0 / np.maximum(T, 1e-3) ** 2, 0.0)
        k = memory.side % 2
        if memory.phase is Phase.MOVE:
            weights[1 - k] = 0.0  # paid out faster than the joint begins to move
        elif memory.phase is Phase.SEEK and (weights[1 - k] or T[k] > SEEK_TENSION):
            weights[k] = 0.0  # its compliance is not known yet
        if weights.any():
            ends = np.array(self._compute_ends(j, memory, reading)) - self._slack[j]
            ends[1:] *= -1.0
            self.travel[j] = weights @ ends / weights.sum() - self._passing[j] @ self.travel

    def _compute_ends(self, j: int, memory: ProcedureState, reading: Array) -> list[float]:
        """Return the travel of each sheath's end of a joint [m], towards its housing."""
        return [
            float(reading[k])
            - T * (memory.stops[i].compliance if i < len(memory.stops) else self._compliance[k])
            for i, (k, T) in enumerate(zip(self._joints[j], memory.tension, strict=True))
        ]

    def compute_lane(self, stage: Stage) -> float:
        """Return how far [m] the tendon of a stage has to move its joint yet."""
        (j,) = stage.joints
        low, high = self.stops[j]
        goal = 0.5 * (low + high) + 0.5 * stage.target * (high - low)
        if np.isnan(goal):  # one stop is not found yet: back to where it began
            goal = 0.0
        return float(goal - self.travel[j]) * (1 - 2 * (stage.side % 2))

    def follow(
        self, config: InitialiseConfig, j: int, tension: Array, dt: float
    ) -> dict[int, float]:
        """Return by how much [m] motors of other joints follow joint `j`, by their tendon.

        Both tendons of a pair go with the joint; both wind in if one is hardly taut, and pay out if
        one is strained, which leaves their joint where it is.
        """
        share = -np.expm1(-dt / SMOOTH_S)
        before = tension if self._smooth is None else self._smooth
        self._smooth = before + share * (tension - before)
        largest = 2.0 * config.seek_speed * dt  # what is more is a correction, not a motion
        moved = np.clip(self.travel - self._before, -largest, largest)
        self._before = self.travel.copy()
        moves: dict[int, float] = {}
        for k in np.flatnonzero(self._passing[:, j]):
            tendons = list(self._joints[int(k)])
            T, along = self._smooth[tendons], float(self._passing[k] @ moved)
            excess = float(T.max()) - STRAIN_RATIO * config.take_up
            wind = compute_holding_speed(config, float(T.min()), config.keep, DEAD_BAND_HIGH, 0.0)
            if excess > 0.0:
                wind = -min(TENSION_GAIN * excess, config.seek_speed)
            for sign, tendon in zip((1.0, -1.0), tendons, strict=False):
                moves[tendon] = sign * along + wind * dt
        return moves
