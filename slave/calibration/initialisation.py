"""Calibrate a rig: run the procedure, evaluate it, assemble the calibration file."""

from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from datetime import UTC, datetime
from typing import NamedTuple

from slave.calibration.analysis import JointResult, analyse_procedure
from slave.calibration.calibration_file import Calibration, apply_guide_friction, find_misfit
from slave.calibration.guide_friction import (
    NO_GUIDES,
    GuideFit,
    build_bends,
    build_guide_entries,
    identify_guide_friction,
    list_arm_stretches,
)
from slave.calibration.procedure_log import ProcedureData
from slave.calibration.procedure_run import ProcedureLimits, ProcedureProgress, run_procedure
from slave.config import SlaveConfig
from slave.rig import Rig, RigSample
from teleop.config.arm import ArmConfig, assemble_tendon_rows
from teleop.errors import UsageError
from teleop.runtime.clock import Tick
from teleop.runtime.realtime import use_ordinary_scheduling


class InitialiseResult(NamedTuple):
    """A new calibration and the data it was made from."""

    calibration: Calibration
    record: ProcedureData
    # all, oldest first, to initialise the estimators' tension profiles
    samples: tuple[RigSample, ...]
    motor: tuple[float, ...]  # [m] written last, where the motors hold


def initialise(
    rig: Rig,
    config: SlaveConfig,
    ticks: Iterable[Tick],
    start_ns: int,
    *,
    quick: bool = True,
    joints: Sequence[int] = (),
    together: bool = False,
    earlier: Calibration | None = None,
    stopped: Callable[[], str] = lambda: "",
    progress: Callable[[ProcedureProgress], None] = lambda _: None,
    analysing: Callable[[], AbstractContextManager[None]] = nullcontext,
    arms: Sequence[ArmConfig] = (),
) -> InitialiseResult:
    """Calibrate a rig; the joints end in mid-range, their tendons just taut.

    `UsageError` if the config forbids it, `slave.calibration.procedure_run.CalibrationRefused` if
    the procedure was aborted.

    Parameters
    ----------
    rig : Rig
        Open; nothing else may use it meanwhile.
    config : SlaveConfig
        Its `initialise` and `gate` are used.
    ticks, start_ns, together, stopped, progress
        See `slave.calibration.procedure_run.run_procedure`.
    quick : bool
        Whether to run the short procedure.
    joints : sequence of int
        Joints to calibrate, counted from 0; empty = all.
    earlier : Calibration, optional
        Of this rig, for the joints that are not calibrated now and the ranges of the others.
    analysing : callable
        Returns a context for the analysis, which takes seconds and asks nobody whether to go on.
    arms : sequence of ArmConfig
        Of the session; friction at the joints that tendons pass is identified, too.
    """
    chosen = tuple(joints) or tuple(range(len(rig.joints)))
    in_part = len(chosen) < len(rig.joints)
    if in_part:
        _require_earlier_calibration(rig, earlier)
    procedure = config.initialise.to_quick() if quick else config.initialise
    limits = ProcedureLimits(procedure, config.gate)
    try:
        ratio = assemble_tendon_rows(arms, rig.joints).travel[[joint[0] for joint in rig.joints]]
    except ValueError as error:
        raise UsageError(f"arms: {error}") from error
    if any(arm.has_tendon_rows for arm in arms):
        raise UsageError(
            "arms.radii: a rig with rows for single tendons cannot be calibrated; fit each sheath "
            "with its tip blocked (teleop estimate DATA --fit --save FILE)"
        )
    driven = run_procedure(rig, limits, ticks, start_ns, chosen, together, stopped, progress, ratio)
    ranges = earlier.ranges if earlier is not None and find_misfit(earlier, rig) is None else ()
    with analysing(), use_ordinary_scheduling():  # it computes for seconds, while the motors hold
        fit = NO_GUIDES
        if arms:
            bends = build_bends(rig.joints, arms)
            fit = identify_guide_friction(driven.record, bends, procedure.gain_error)
        in_arm = list_arm_stretches(
            driven.record, apply_guide_friction(arms, build_guide_entries(fit))
        )
        results = analyse_procedure(driven.record, procedure, ranges, fit.sums, in_arm)
    method = f"pulls and releases against the stops, {'quick' if quick else 'full'} form"
    now = datetime.now(UTC).isoformat(timespec="seconds")
    calibration = assemble_calibration(results, rig, method, now, earlier if in_part else None, fit)
    return InitialiseResult(calibration, driven.record, driven.samples, driven.motor)


def assemble_calibration(
    results: Sequence[JointResult],
    rig: Rig,
    method: str,
    time: str,
    earlier: Calibration | None,
    fit: GuideFit,
) -> Calibration:
    """Return the calibration of a whole rig from new results and an earlier calibration."""
    guides = {guide.joint: guide for guide in earlier.guides} if earlier else {}
    guides |= {guide.joint: guide for guide in build_guide_entries(fit)}
    tendons = dict(enumerate(earlier.tendons)) if earlier else {}
    calibrated = {result.joint for result in results}
    directions = [
        d for d in (earlier.directions if earlier else ()) if d.joint - 1 not in calibrated
    ]
    ranges = list(earlier.ranges if earlier and earlier.ranges else [None] * len(rig.joints))
    for result in results:
        tendons |= zip(rig.joints[result.joint], result.tendons, strict=True)
        directions += result.directions
        ranges[result.joint] = result.range
    directions.sort(key=lambda d: (d.joint, d.tendon))
    if earlier is not None and len(calibrated) < len(rig.joints):
        missing = ", ".join(str(j + 1) for j in range(len(rig.joints)) if j not in calibrated)
        method += f"; joint {missing} as of {earlier.time or 'earlier'}"
    remarks = [f"joint {d.joint}, tendon {d.tendon}: {d.remark}" for d in directions if d.remark]
    return Calibration(
        tendons=tuple(tendons[k] for k in range(rig.tendons)),
        rig=rig.name,
        joints=rig.joints,
        time=time,
        method=method,
        remark="; ".join([*remarks, *filter(None, [fit.remark])]),
        directions=tuple(directions),
        ranges=tuple(ranges),
        guides=tuple(guides[joint] for joint in sorted(guides)),
    )


def _require_earlier_calibration(rig: Rig, earlier: Calibration | None) -> None:
    """Raise `UsageError` if there is no earlier calibration for the other joints."""
    if earlier is None:
        raise UsageError(
            "--joint needs an earlier calibration of the other joints: calibrate all joints, or "
            "give the earlier file by --out or slave.calibration"
        )
    misfit = find_misfit(earlier, rig)
    if misfit is None and earlier.joints != rig.joints:
        misfit = "it does not assign tendons to joints"
    if misfit is not None:
        raise UsageError(
            f"the earlier calibration does not fit this rig: {misfit}; calibrate all joints"
        )
