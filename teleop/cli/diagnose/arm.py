"""Diagnosis of an arm: all tendons of a table or a recording, with the config of the arm."""

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimator.array_types import Array
from estimator.diagnosis import arm_report
from estimator.diagnosis.arm import ArmDiagnosis, diagnose_arm
from estimator.diagnosis.arm_model import ArmData
from estimator.diagnosis.record import RecordError
from estimator.law.sheath import Sheath
from estimator.routing.routing import Routing
from slave.arm_estimate import build_routing, cut_sheaths
from slave.config import SlaveConfig, load_tendon_configs
from teleop.cli import estimate
from teleop.cli.html_page import Page, to_json_values
from teleop.config.loading import load
from teleop.data.mapping_file import load_mapping
from teleop.data.measured_table import MeasuredTable, read_tables
from teleop.data.standard_columns import (
    ANCHOR_TENSION,
    JOINT_ANGLE,
    TENSIONS,
    Columns,
    format_numbered_name,
)
from teleop.errors import UsageError
from teleop.runtime.output_file import make_folder
from teleop.runtime.process import write_summary, write_text_file
from teleop.runtime.status_line import Progress
from teleop.session.config import RunConfig


def is_of_arm(args: argparse.Namespace) -> bool:
    """Return whether all tendons of an arm are to be diagnosed together.

    A config that is given must describe an arm; that of a recording is used if it does.

    Raises `UsageError` if the config has no arm, or options do not go with one.
    """
    if args.tendon is not None:
        return False
    path = args.config or args.data[0]
    if args.config is None and not estimate.is_recording(path):
        return False
    try:
        has_arm = bool(load(path, RunConfig, None).arms)
    except UsageError:
        if args.config is not None:
            raise
        return False
    if not has_arm:
        if args.config is None:
            return False
        raise UsageError(f"{path}: has no arms; --config is for the arm of the data")
    if len(args.data) > 1 or args.validate:
        raise UsageError(f"{path}: describes an arm, of which one file is diagnosed at a time")
    for name in ("calibration", "supplement", "cause", "leave_one_file_out", "fit_all"):
        if getattr(args, name):
            option = name.replace("_", "-")
            raise UsageError(f"--{option}: is for one tendon; say which one by --tendon")
    return True


def run(args: argparse.Namespace, noise: dict[str, float]) -> int:
    """Diagnose an arm and report; returns the exit code."""
    path = args.config or args.data[0]
    config, arms = load(path, SlaveConfig, "slave"), load(path, RunConfig, None).arms
    joints = estimate.get_joint_tendons(config)
    if not joints:
        raise UsageError(f"{path}: slave.rig does not tell the tendons of the joints")
    names = [f"{k}{'ab'[i]}" for k, of in enumerate(joints, 1) for i in range(len(of))]
    routing = build_routing(joints, arms)
    tendons = load_tendon_configs(config, len(names), joints)
    sheaths = [tendon.build_model().sheath for tendon in tendons]
    mapping = load_mapping(args)
    tables = read_tables(
        args.data[0],
        [Columns.from_tendon(k) for k in range(1, len(names) + 1)],
        args.drop_nonfinite,
        zero_errors=TENSIONS,
        diagnosed=True,
        mapping=mapping,
    )
    if args.out is not None:
        make_folder(args.out, "report.html")
    progress = Progress()
    try:
        data = build_arm_data(tables, names, routing, sheaths)
        in_sheaths = cut_sheaths(sheaths, joints, arms)
        diagnosis = diagnose_arm(data, routing, in_sheaths, noise=noise, report=progress)
    except RecordError as error:
        raise UsageError(f"{args.data[0]}: {error}") from error
    finally:
        progress.end()
    tree = build_tree(diagnosis)
    write_summary(args.json, tree)
    print(arm_report.format_arm_summary(diagnosis), flush=True)
    if args.out is not None:
        write_summary(args.out / "report.json", tree)
        write_text_file(args.out / "report.html", render(diagnosis, args.data[0]), "the page")
        print(f"\nwritten: {args.out / 'report.html'}")
    return 0


def build_arm_data(
    tables: tuple[MeasuredTable, ...], names: list[str], routing: Routing, sheaths: list[Sheath]
) -> ArmData:
    """Return the data of an arm; angles that were not measured are computed from the travels."""
    path, extra = tables[0].path, tables[0].extra
    angles = [extra.get(JOINT_ANGLE.format(j)) for j in range(1, routing.joints + 1)]
    has_encoders = any(angle is not None for angle in angles)
    missing = [JOINT_ANGLE.format(j) for j, angle in enumerate(angles, 1) if angle is None]
    if has_encoders and missing:
        raise UsageError(f"{path}: no column {missing[0]!r}; give the angles of all joints or none")
    travel = _stack([table.proximal_displacement for table in tables])
    anchors = [extra.get(format_numbered_name(ANCHOR_TENSION, k)) for k in range(1, len(names) + 1)]
    anchor = _stack([None if a is None else np.asarray(a, np.float64) for a in anchors])
    tension = np.column_stack([table.proximal_tension for table in tables])
    if has_encoders:
        theta = np.column_stack([np.asarray(angle, np.float64) for angle in angles])
    else:
        tip = _stack([table.distal_displacement for table in tables])
        if tip is None and travel is None:
            raise UsageError(
                f"{path}: no angles and no travels: add {JOINT_ANGLE.format(1)!r}, ..."
            )
        if tip is None:
            compliance = np.array([s.length / s.axial_stiffness for s in sheaths])
            tip = np.asarray(travel) - compliance * tension
        theta = np.nan_to_num(tip) @ np.linalg.pinv(np.asarray(routing.radii)).T
    return ArmData(
        tables[0].time,
        tension,
        travel,
        _stack([table.distal_tension for table in tables]) if anchor is None else anchor,
        theta,
        anchor is not None,
        has_encoders,
        tuple(names),
    )


def _stack(columns: list[Array | NDArray[np.float64] | None]) -> Array | None:
    present = [column for column in columns if column is not None]
    return np.column_stack(present) if len(present) == len(columns) else None


def build_tree(diagnosis: ArmDiagnosis) -> dict[str, object]:
    """Return the report for programs, in SI units; joints count from 1."""
    tendons = [tendon.name for tendon in diagnosis.tendons]
    tree = {
        "verdict": "clean"
        if diagnosis.is_clean
        else "named"
        if diagnosis.causes
        else "unexplained",
        "headline": arm_report.format_headline(diagnosis),
        "causes": [
            {
                "name": entry.cause.kind,
                "joint": entry.cause.joint + 1 if entry.cause.joint >= 0 else None,
                "tendons": [tendons[i] for i in entry.cause.tendons],
                "sentence": arm_report.describe_cause(diagnosis, entry),
                "advice": arm_report.give_advice(entry),
                "unit": entry.cause.unit,
                "score": entry.score,
                "ambiguous_with": [rival.kind for rival in entry.rivals],
                **entry.value._asdict(),
            }
            for entry in diagnosis.causes
        ],
        "tendons": diagnosis.tendons,
        "notes": arm_report.list_notes(diagnosis),
    }
    values: dict[str, object] = to_json_values(tree)
    return values


def render(diagnosis: ArmDiagnosis, path: Path) -> str:
    """Return the page of the report."""
    page = Page(arm_report.format_headline(diagnosis))
    page.add_text(f"Diagnosis of the arm in {path}, with the motion of all joints known.")
    for entry in diagnosis.causes:
        rows = [("what is wrong", arm_report.describe_cause(diagnosis, entry))]
        rows.append(("what to do", arm_report.give_advice(entry)))
        if entry.rivals:
            rows.append(("or", ", ".join(rival.kind for rival in entry.rivals)))
        page.add_card(entry.cause.kind, rows)
    page.add_points(arm_report.list_notes(diagnosis))
    page.add_table(arm_report.build_tendon_table(diagnosis), "no")
    return page.render()
