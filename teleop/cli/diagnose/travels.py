"""Report of motor travel and tip travel without a tension: what a reversal loses, and why."""

import argparse
import math
from collections.abc import Sequence
from typing import Any

from estimator.diagnosis.outcome import Verdict
from estimator.diagnosis.record import RecordError
from estimator.diagnosis.settings import SETTINGS
from estimator.diagnosis.travel_diagnosis import TravelDiagnosis, diagnose_travels
from estimator.effects.effect import DISTAL_DISPLACEMENT, PROXIMAL_DISPLACEMENT
from estimator.fitting import IntervalEstimate
from estimator.report_table import Table
from estimator.units import format_quantity
from teleop.cli.html_page import Page, to_json_values
from teleop.data.measured_table import MeasuredTable
from teleop.errors import UsageError
from teleop.runtime.process import write_summary, write_text_file

_UNUSED_OPTIONS = (
    *("calibration", "supplement", "cause", "leave_one_file_out", "fit_all", "validate"),
    *("noise", "variable"),
)


def run(args: argparse.Namespace, tables: Sequence[MeasuredTable]) -> int:
    """Diagnose and report; returns the exit code."""
    diagnosis, tree = write_report(args, tables)
    write_summary(args.json, tree)
    points = "\n".join(f"- {point}" for point in _list_points(diagnosis))
    table = build_table(diagnosis).to_markdown()
    print(f"{format_headline(diagnosis)}\n\n{points}\n\n{table}", flush=True)
    if args.out is not None:
        print(f"\nwritten: {args.out / 'report.html'}")
    return 0


def write_report(
    args: argparse.Namespace, tables: Sequence[MeasuredTable]
) -> tuple[TravelDiagnosis, dict[str, Any]]:
    """Return the diagnosis and its tree, both reports written to `--out`; raises `UsageError`."""
    options = {name: getattr(args, name) for name in _UNUSED_OPTIONS}
    options["effects"] = args.effects != "all"
    for name in (name for name, value in options.items() if value):
        raise UsageError(
            f"--{name.replace('_', '-')}: needs a tension, and {tables[0].path} has two travels "
            "only"
        )
    try:
        diagnosis = diagnose_travels(tables)
    except RecordError as error:
        raise UsageError(str(error)) from error
    tree = build_tree(diagnosis, [item.name for item in tables])
    if args.out is not None:
        page = Page(format_headline(diagnosis))
        page.add_points(_list_points(diagnosis))
        page.add_table(build_table(diagnosis), "taken")
        write_summary(args.out / "report.json", tree)
        write_text_file(args.out / "report.html", page.render(), "the page")
    return diagnosis, tree


def _list_points(diagnosis: TravelDiagnosis) -> list[str]:
    return [*list_findings(diagnosis), *list_limits(diagnosis)]


def build_tree(diagnosis: TravelDiagnosis, files: Sequence[str]) -> dict[str, Any]:
    """Return the report for programs, in SI units."""
    fields = ("verdict", "lost", "lost_loaded", "gain", "friction", "stretch", "missed_share")
    values: dict[str, Any] = to_json_values(
        {name: getattr(diagnosis, name) for name in (*fields, "noise")}
        | {"headline": format_headline(diagnosis), "files": list(files)}
        | {"left": diagnosis.residual_fraction, "unit": diagnosis.units.travel}
        | {"models": {stage.name: stage.rmse for stage in diagnosis.stages}}
        | {"tried": {stage.name: stage.rmse for stage in diagnosis.others}}
        | {"next": list_limits(diagnosis)}
    )
    return values


def format_headline(diagnosis: TravelDiagnosis) -> str:
    """Return the verdict in a sentence."""
    if diagnosis.missed_share > SETTINGS.foreign_share_max:
        return (
            "This is not a tendon-sheath transmission, or the columns are not what they are taken "
            f"for: the best play misses {diagnosis.missed_share:.0%} of the tip's changes."
        )
    if diagnosis.verdict is Verdict.CLEAN:
        return "The tip follows the motor in proportion: no travel is lost beyond noise."
    if diagnosis.verdict is Verdict.UNEXPLAINED:
        return "The tip does not follow the motor in proportion, and no play explains it."
    names = [stage.name for stage in diagnosis.stages]
    if "widening_play" in names:
        return (
            "Each reversal takes motor travel that grows with the load: "
            f"{_format_lost(diagnosis, diagnosis.lost)} without load, "
            f"{_format_lost(diagnosis, diagnosis.lost_loaded)} at the largest."
        )
    if "play" in names:
        return f"Each reversal takes {_format_lost(diagnosis, diagnosis.lost)} of motor travel."
    return f"Reversals take no travel beyond noise, but of the tip: {diagnosis.stages[-1].words}."


def _format_lost(diagnosis: TravelDiagnosis, lost: IntervalEstimate) -> str:
    unit = diagnosis.units.travel
    low, high = (format_quantity(end, unit, 3) for end in lost[1:])
    share = lost.value / max(float(r.drive.max() - r.drive.min()) for r in diagnosis.records)
    return f"{format_quantity(lost.value, unit, 3)} ({low} to {high}; {share:.1%} of its range)"


def list_findings(diagnosis: TravelDiagnosis) -> list[str]:
    """Return what the data determine, in words."""
    if diagnosis.verdict is not Verdict.CHARACTERISED:
        return []
    findings = [
        f"Beside the play, of the tip: {stage.words}."
        for stage in diagnosis.stages
        if not stage.name.endswith(("line", "play"))
    ]
    findings.append(f"The tip moves {diagnosis.gain:.4g} times as far as the play's output.")
    if any(stage.name == "widening_play" for stage in diagnosis.stages):
        findings.append(
            "What is lost without load is backlash or slack, or friction of a pretension; what "
            "grows with the load is the tendon's elongation under the friction of the sheath."
        )
    if not math.isnan(diagnosis.friction):
        findings.append(
            "If the motor's travel is the tendon's own, without gear or other radius at the tip, "
            f"K is {diagnosis.friction:.3g}, and L/EA times the load's stiffness "
            f"{diagnosis.stretch:.3g}."
        )
    return findings


def list_limits(diagnosis: TravelDiagnosis) -> list[str]:
    """Return what two travels cannot tell, and what would."""
    travel, tip = map(diagnosis.units.name_channel, (PROXIMAL_DISPLACEMENT, DISTAL_DISPLACEMENT))
    return [
        f"Not determined by {travel} and {tip} alone: tensions, the force at the tip, L/EA and the "
        "load's stiffness each by themselves, and K where a gear or a radius scales one of them. "
        "There is no model file.",
        "Record the tension at the housing: then the whole catalogue is tried.",
    ]


def build_table(diagnosis: TravelDiagnosis) -> Table:
    """Return the held-out errors of all models."""
    unit = diagnosis.units.travel
    tagged = [(s, "taken") for s in diagnosis.stages] + [(s, "") for s in diagnosis.others]
    rows = [(s.words, format_quantity(s.rmse, unit, 3), taken) for s, taken in tagged]
    rows.append(("noise", format_quantity(diagnosis.noise, unit, 2), ""))
    return Table(
        ("model of the tip, each with those taken above", "held-out RMSE", ""), tuple(rows)
    )
