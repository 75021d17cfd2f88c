"""One sample of all tendons against all that counts as a fault."""

from collections.abc import Sequence
from math import isfinite
from typing import NamedTuple

from estimator.memory import SIGMA_T
from estimator.online import Prepared
from slave.control import TendonSeen
from slave.watch.cell import Cell, suspect, watch_cell
from slave.watch.config import WatchConfig
from slave.watch.slack import TAUT, Slack, watch_slack
from slave.watch.winding import (
    NEVER,
    Compliance,
    Winding,
    Wound,
    average,
    compliance,
    watch_winding,
)
from teleop.session import Reason


class Finding(NamedTuple):
    """A fault and where it is."""

    reason: Reason
    tendon: int  # counted from 0


class Known(NamedTuple):
    """What is known of a tendon beforehand."""

    compliance: Compliance
    noise: float  # [N] of its load cell


class Watch(NamedTuple):
    """Memory of the watch."""

    known: tuple[Known, ...]
    cells: tuple[Cell, ...]
    wounds: tuple[Wound, ...]
    slacks: tuple[Slack, ...]
    windings: tuple[Winding, ...]  # one for each joint; of a single tendon, it stays as it is


def start(joints: Sequence[Sequence[int]], prepared: Sequence[Prepared]) -> Watch:
    """Return the memory before the first sample, from `Rig.joints` and the tendons' models."""
    known = tuple(Known(compliance(p), float(p.constants[SIGMA_T])) for p in prepared)
    n = len(known)
    return Watch(known, (Cell(),) * n, (NEVER,) * n, (TAUT,) * n, (Winding(),) * len(joints))


def step(
    config: WatchConfig,
    joints: Sequence[Sequence[int]],
    memory: Watch,
    tendons: Sequence[TendonSeen],
    dt: float,
) -> tuple[Finding | None, Watch]:
    """Take one sample of the rig; return what is found wrong now, if anything, and the new memory.

    Parameters
    ----------
    joints : sequence of sequences of int
        Which tendons each joint has, `Rig.joints`.
    tendons : sequence of TendonSeen
        The sample. One that the estimator refused tells nothing.
    dt : float
        Time since the sample before [s].
    """
    dt = dt if dt > 0.0 else 0.0
    found = None
    cells, wounds = list(memory.cells), list(memory.wounds)
    for i, tendon in enumerate(tendons):
        if not tendon.valid:
            continue
        T, q = tendon.tension, tendon.displacement
        reason, cells[i] = watch_cell(config, memory.known[i].noise, cells[i], T, q, dt)
        wounds[i] = average(wounds[i], T, q, dt)
        if found is None and reason is not Reason.NONE:
            found = Finding(reason, i)
    slacks, windings = list(memory.slacks), list(memory.windings)
    for k, joint in enumerate(joints):
        if not all(_tells(tendons[i], cells[i], memory.known[i].noise) for i in joint):
            continue
        total = sum(wounds[i].displacement for i in joint)
        for i in joint:
            tension, before = tendons[i].tension, wounds[i].tension
            broken, slacks[i] = watch_slack(config, slacks[i], tension, before, total, dt)
            if broken and found is None:
                found = Finding(Reason.TENDON_BROKEN, i)
        if len(joint) > 1:
            a, b = joint
            reason, n, windings[k] = watch_winding(
                config,
                windings[k],
                (wounds[a], wounds[b]),
                (memory.known[a].compliance, memory.known[b].compliance),
                (slacks[a], slacks[b]),
                dt,
            )
            if reason is not Reason.NONE and found is None:
                found = Finding(reason, joint[n])
    after = Watch(memory.known, tuple(cells), tuple(wounds), tuple(slacks), tuple(windings))
    return found, after


def _tells(tendon: TendonSeen, cell: Cell, noise: float) -> bool:
    """Return whether the winding of a tendon's joint can be judged by it."""
    return tendon.valid and isfinite(tendon.displacement) and not suspect(cell, noise)
