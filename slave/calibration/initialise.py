"""From a rig to its calibration: the procedure, its analysis, and the file's content."""

from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from typing import NamedTuple

from slave.calibration.analysis import JointResult, analyse
from slave.calibration.file import Calibration, fits
from slave.calibration.run import Limits, ProcedureData, Progress, drive
from slave.config import SlaveConfig
from slave.rig import Rig, RigSample
from teleop.clock import Tick
from teleop.errors import UsageError


class InitialiseResult(NamedTuple):
    """A calibration just made, and what it was made from."""

    calibration: Calibration
    record: ProcedureData
    samples: tuple[RigSample, ...]  # all, oldest first: estimators fed with them know the profile


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
    progress: Callable[[Progress], None] = lambda _: None,
) -> InitialiseResult:
    """Calibrate a rig; the joints then stand in the middle, their tendons just taut.

    Parameters
    ----------
    rig : Rig
        Open; nothing else may use it meanwhile.
    config : SlaveConfig
        Its `initialise` and `gate` are used.
    ticks, start_ns, together, stopped, progress
        See `slave.calibration.run.drive`.
    quick : bool
        Whether to do the short form.
    joints : sequence of int
        Which joints, counted from 0; all if none are named.
    earlier : Calibration, optional
        Of this rig: it knows the joints that are not done now, and how far the others went.

    Raises
    ------
    TeleopError
        `UsageError` if the config forbids it, `slave.calibration.run.CalibrationRefused` if the
        procedure was aborted.
    """
    chosen = tuple(joints) or tuple(range(len(rig.joints)))
    in_part = len(chosen) < len(rig.joints)
    if in_part:
        _require_rest(rig, earlier)
    procedure = config.initialise.quick() if quick else config.initialise
    limits = Limits(procedure, config.gate)
    driven = drive(rig, limits, ticks, start_ns, chosen, together, stopped, progress)
    ranges = earlier.ranges if earlier is not None and fits(earlier, rig) is None else ()
    results = analyse(driven.record, procedure, ranges)
    method = f"pulls and releases against the stops, {'quick' if quick else 'full'} form"
    now = datetime.now(UTC).isoformat(timespec="seconds")
    calibration = assemble_calibration(results, rig, method, now, earlier if in_part else None)
    return InitialiseResult(calibration, driven.record, driven.samples)


def assemble_calibration(
    results: Sequence[JointResult],
    rig: Rig,
    method: str,
    time: str,
    earlier: Calibration | None = None,
) -> Calibration:
    """Return what is known of a whole rig: the results, and what was known of its other joints."""
    tendons = dict(enumerate(earlier.tendons)) if earlier else {}
    done = {result.joint for result in results}
    directions = [d for d in (earlier.directions if earlier else ()) if d.joint - 1 not in done]
    ranges = list(earlier.ranges if earlier and earlier.ranges else [None] * len(rig.joints))
    for result in results:
        tendons |= zip(rig.joints[result.joint], result.tendons, strict=True)
        directions += result.directions
        ranges[result.joint] = result.range
    directions.sort(key=lambda d: (d.joint, d.tendon))
    if earlier is not None and len(done) < len(rig.joints):
        others = ", ".join(str(j + 1) for j in range(len(rig.joints)) if j not in done)
        method += f"; joint {others} as of {earlier.time or 'earlier'}"
    return Calibration(
        tendons=tuple(tendons[k] for k in range(rig.tendons)),
        rig=rig.name,
        joints=rig.joints,
        time=time,
        method=method,
        remark="; ".join(
            f"joint {d.joint}, tendon {d.tendon}: {d.remark}" for d in directions if d.remark
        ),
        directions=tuple(directions),
        ranges=tuple(ranges),
    )


def _require_rest(rig: Rig, earlier: Calibration | None) -> None:
    """Refuse to calibrate some joints where nothing is known of the others."""
    if earlier is None:
        raise UsageError(
            "some joints alone need an earlier calibration of the others: calibrate all, or name "
            "the file of the earlier one by --out or slave.calibration"
        )
    misfit = fits(earlier, rig)
    if misfit is None and earlier.joints != rig.joints:
        misfit = "it does not say which joint has which tendons"
    if misfit is not None:
        raise UsageError(f"the earlier calibration does not fit: {misfit}; calibrate all joints")
