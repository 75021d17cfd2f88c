"""Estimate the distal tension in measured data, offline, with the numbers a live slave would give.

  teleop estimate bench.csv --fit                      fit K to the measured distal tension
  teleop estimate bench.csv --fit --save sheath.yaml   ... and keep it as a calibration
  teleop estimate run.csv --calibration sheath.yaml --out estimates.csv
  teleop estimate run.csv --config configs/demo.yaml   with the model of a config (slave.tendons)

The data: a CSV, CSV.gz or Parquet table with time_s and proximal_tension_N, optionally
proximal_displacement_m, distal_tension_N and distal_displacement_m; or a recording (.mcap).
With a distal tension the estimate is judged against it.
"""

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from estimator import online
from slave import fitting
from slave.calibration import file
from slave.calibration.file import Calibration
from slave.config import SlaveConfig, tendon_configs
from slave.fitting import Fit
from slave.score import Score
from slave.table import Columns, MeasuredTable, check_destination, read_table, write_table
from slave.tendon_config import TendonConfig
from teleop.config import add_arguments as add_config_arguments
from teleop.config import as_tree, load
from teleop.errors import UsageError
from teleop.launch.summary import force_line
from teleop.messages import PHASE_NAMES
from teleop.process import destination, write_summary


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop estimate`."""
    parser.add_argument("data", type=Path, metavar="DATA", help="measured data, or a recording")
    model = parser.add_argument_group("the model of the sheath, one of")
    model.add_argument("--fit", action="store_true", help="fit it to the data")
    model.add_argument("--calibration", type=Path, metavar="FILE", help="a calibration file")
    add_config_arguments(parser)
    fit = parser.add_argument_group("with --fit")
    fit.add_argument(
        "--save", type=destination, metavar="FILE", help="write the fit as a calibration"
    )
    fit.add_argument(
        "--rig",
        default="",
        metavar="NAME",
        help="of --save: the rig (slave.rig.name) that the fit is to be used on; without it the "
        "calibration is good for playing measured data only",
    )
    fit.add_argument(
        "--blocked-tip",
        action="store_true",
        help="a pull-release loop with a tip that cannot move: K and EA from the housing alone",
    )
    fit.add_argument(
        "--length",
        type=float,
        default=1.0,
        metavar="M",
        help="[m] of the sheath; EA scales with it",
    )
    parser.add_argument(
        "--column",
        action="append",
        default=[],
        metavar="NAME=COLUMN",
        help="what the data call proximal_tension, proximal_displacement, distal_tension, "
        "distal_displacement or time, e.g. --column proximal_tension=T_in",
    )
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the estimates as a table")
    parser.add_argument(
        "--json", type=destination, metavar="FILE", help="write the summary to FILE"
    )
    parser.add_argument(
        "--drop-nonfinite",
        action="store_true",
        help="leave out rows with values that are not finite",
    )


def main(args: argparse.Namespace) -> int:
    """Estimate, and say how good it is; returns the exit code."""
    check_words(args)
    if args.out is not None:
        check_destination(args.out)
    table = read_table(args.data, named(args.column), args.drop_nonfinite)
    summary: dict[str, Any] = {"data": str(args.data), "samples": len(table.time)}
    if args.fit:
        fit = fitting.fit(table, args.blocked_tip, args.length)
        if args.save is not None:
            save(args.save, fit, table, args.rig)
        tendon = fit.tendon
        summary["fit"] = {
            "method": fit.method,
            "parameters": {name: p._asdict() for name, p in fit.parameters.items()},
            "believe": fit.believe,
            "reason": fit.reason,
        }
    else:
        tendon = configured(args)
    estimates = online.run(
        online.prepare(tendon.model()),
        table.time,
        table.proximal_tension,
        table.proximal_displacement,
    )
    summary["model"] = as_tree(tendon)
    summary["force_error"] = judged(estimates, table)
    summary["travel_contradicts"] = travel_contradicts(tendon, table, summary["force_error"])
    summary["status"] = {
        str(flag.name).lower(): float(np.mean(estimates.status & flag != 0))
        for flag in online.Status
        if flag
    }
    summary["phase"] = {
        name: float(np.mean(estimates.phase == k)) for k, name in enumerate(PHASE_NAMES)
    }
    if args.out is not None:
        write_table(args.out, table.columns() | columns(estimates))
    write_summary(args.json, summary)
    print("\n".join(in_words(summary)))
    return 0


def check_words(args: argparse.Namespace) -> None:
    """Refuse options that contradict each other, before anything is read."""
    configured = args.config is not None or bool(args.overrides)
    models = [args.fit, args.calibration is not None, configured]
    if sum(models) != 1:
        raise UsageError(
            "which sheath is it? Give one of --fit (needs a distal tension in the data), "
            "--calibration FILE, and --config FILE"
        )
    if not args.fit and (args.save is not None or args.blocked_tip):
        raise UsageError("--save and --blocked-tip go with --fit")
    if args.rig and args.save is None:
        raise UsageError("--rig goes with --save")


def named(words: Sequence[str]) -> Columns:
    """Return the columns' names with those given as NAME=COLUMN put in."""
    known = [f.name for f in dataclasses.fields(Columns)]
    given = {}
    for word in words:
        name, equals, column = word.partition("=")
        if name not in known or not equals or not column:
            raise UsageError(
                f"--column {word}: expected NAME=COLUMN, NAME one of {', '.join(known)}"
            )
        given[name] = column
    return dataclasses.replace(Columns(), **given)


def travel_contradicts(
    tendon: TendonConfig, table: MeasuredTable, error: dict[str, Any] | None
) -> bool:
    """Return whether leaving the travel out would make the estimate a different one altogether."""
    if error is None or table.proximal_displacement is None:
        return False
    alone = online.run(online.prepare(tendon.model()), table.time, table.proximal_tension)
    without = judged(alone, table)
    return (
        without is not None
        and error["rmse_N"] > 2.0 * without["rmse_N"] + 0.01 * error["full_scale_N"]
    )


def configured(args: argparse.Namespace) -> TendonConfig:
    """Return the model that the calibration file or the config names."""
    if args.calibration is not None:
        config = SlaveConfig(calibration=args.calibration)
    else:
        config = load(args.config, SlaveConfig, "slave", args.overrides)
    return tendon_configs(config, 1)[0]


def judged(estimates: online.Estimates, table: MeasuredTable) -> dict[str, Any] | None:
    """Return the error against the measured distal tension, None without one."""
    if table.distal_tension is None:
        return None
    score = Score()
    rows = (estimates.distal_tension, estimates.low, estimates.high, table.distal_tension)
    for row in zip(*(column.tolist() for column in rows), strict=True):
        score.add(*row)
    return score.summary()


def columns(estimates: online.Estimates) -> dict[str, Any]:
    """Return the estimates as columns of a table."""
    return {
        "distal_tension_estimate_N": estimates.distal_tension,
        "distal_tension_low_N": estimates.low,
        "distal_tension_high_N": estimates.high,
        "elongation_estimate_m": estimates.elongation,
        "distal_displacement_estimate_m": estimates.distal_displacement,
        "front_m": estimates.front,
        "phase": estimates.phase,
        "status": estimates.status,
    }


def save(path: Path, fit: Fit, table: MeasuredTable, rig: str) -> None:
    """Write a calibration that `--calibration` and `slave.calibration` take."""
    ends = ", ".join(f"{n} {p.low:.4g} to {p.high:.4g}" for n, p in fit.parameters.items())
    calibration = Calibration(
        tendons=(fit.tendon,),
        rig=rig,
        method=f"{fit.method}; 95 % intervals: {ends}",
        source=f"{table.path.name}, {len(table.time)} samples",
        believed=fit.believe,
        remark=fit.reason,
    )
    file.save(path, calibration)


def in_words(summary: dict[str, Any]) -> list[str]:
    """Return the summary as lines to read."""
    lines = [f"{summary['data']}: {summary['samples']} samples"]
    if "fit" in summary:
        fit = summary["fit"]
        lines.append(f"fit       {fit['method']}")
        for name, p in fit["parameters"].items():
            lines.append(
                f"          {name} = {p['value']:.4g} (95 %: {p['low']:.4g} to {p['high']:.4g})"
            )
        lines.append(
            f"          {'believable' if fit['believe'] else 'NOT to be believed'}: {fit['reason']}"
        )
    lines.append(f"force     {force_line(summary['force_error'])}")
    if summary["travel_contradicts"]:
        lines.append(
            "WARNING   the displacement contradicts the tension: without it the estimate is far "
            "better. Is its unit the metre, and positive while pulling?"
        )
    told = [
        f"{name.replace('_', ' ')} {share:.0%}"
        for name, share in summary["status"].items()
        if share
    ]
    lines.append("status    " + (", ".join(told) or "nothing stands against the estimates"))
    return lines
