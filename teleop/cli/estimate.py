"""Estimate the distal tension in measured data, offline, exactly as a live slave does.

  teleop estimate bench.csv --fit                      fit K to the measured distal tension
  teleop estimate bench.csv --fit --save sheath.yaml   ... and save it as a calibration
  teleop estimate run.csv --calibration sheath.yaml --out estimates.csv
  teleop estimate run.csv --config configs/demo.yaml   with the models of a config (slave.tendons)
  teleop estimate run.csv --model diagnosis/model.yaml     with a model of `teleop diagnose`
  teleop estimate run.csv --calibration sheath.yaml --adapt    ... of a sheath that moves

The data: a CSV, CSV.gz or Parquet table with time_s and proximal_tension_N, optionally
proximal_displacement_m, distal_tension_N and distal_displacement_m; or a recording (.mcap).
A measured distal tension is compared with the estimate.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from estimator.adaptation import FACTOR_MAX, FACTOR_MIN, run_adapting
from estimator.calibration.sheath_fit import LENGTH_MAX, FitError, SheathFit, fit_sheath
from estimator.diagnosis.api import collect_signals
from estimator.measured_data import Samples
from estimator.online import online
from estimator.online.estimator import Estimator
from estimator.online.force_error import FULL_SCALE_SIGMAS, Score
from estimator.pair_adaptation import run_adapting_pair
from estimator.plausibility import find_channel_faults, find_contradiction, find_stretch_slip
from estimator.signals.spikes import remove_spikes
from estimator.units import LINEAR
from slave import model_files
from slave.calibration import calibration_file
from slave.calibration.calibration_file import Calibration, JointTendons
from slave.config import SlaveConfig, load_tendon_configs
from slave.rig import number_joint_tendons
from slave.rigs.hardware import HardwareRigConfig
from slave.rigs.simulated import SimulatedRigConfig
from slave.tendon_config import TendonConfig
from teleop.config.loading import RECORDING_SUFFIX, as_tree, load
from teleop.config.options import TABLE_OPTIONS, add_option, add_options
from teleop.data.mapping_file import load_mapping, parse_column_names
from teleop.data.measured_table import MeasuredTable, get_loop_tension, read_tables, write_table
from teleop.data.read_summary import ReadSummary, format_read_summary
from teleop.data.standard_columns import format_numbered_name
from teleop.errors import UsageError
from teleop.messages.messages import MAX_TENDONS, PHASE_NAMES
from teleop.ros.bag_table import is_bag
from teleop.runtime.output_file import TABLE_SUFFIXES, OutputFile
from teleop.runtime.process import write_summary
from teleop.session.summary import format_force_error


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop estimate`."""
    parser.add_argument("data", type=Path, metavar="DATA", help="measured data, or a recording")
    model = parser.add_argument_group("the model of the sheath, one of")
    model.add_argument("--fit", action="store_true", help="fit it to the data")
    for name in ("--calibration", "--model", "--config"):
        add_option(model, name)
    parser.add_argument(
        "--adapt",
        action="store_true",
        help=(
            "adapt K to a sheath that moves, from the travel: of one tendon against a spring while "
            "the tip rests, of the tendons of a pair, both in DATA, at any time"
        ),
    )
    fit = parser.add_argument_group("with --fit")
    fit.add_argument(
        "--save", type=OutputFile(), metavar="FILE", help="write the fit as a calibration"
    )
    fit.add_argument(
        "--rig",
        default="",
        metavar="NAME",
        help=(
            "with --save: the rig (slave.rig.name) of the calibration; without it, it is only "
            "valid for replayed data"
        ),
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
        help=(
            "length of the sheath [m], also with --model; data determine only EA/L, so EA scales "
            "with it (default 1)"
        ),
    )
    add_options(parser, "--set", "--allow-imports", *TABLE_OPTIONS, "--json")
    parser.add_argument(
        "--tendon",
        metavar="TENDON",
        help="tendon to estimate, if data or model have several: joint and side (1a) or number "
        "(default the first)",
    )
    parser.add_argument(
        "--out",
        type=OutputFile(*TABLE_SUFFIXES),
        metavar="FILE",
        help="write the estimates as a table",
    )


def main(args: argparse.Namespace) -> int:
    """Estimate and report the error; returns the exit code."""
    check_options(args)
    files = model_files.parse(args.model)
    tendons, joints = ((), ()) if args.fit else load_models(args)
    joints = joints or read_recorded_joints(args.data)
    k = select_tendon(args.tendon, joints, len(tendons))
    mapping = load_mapping(args)
    pairs = (tendons for tendons in joints if k in tendons and len(tendons) == 2)
    joint = next(pairs, (k,)) if args.adapt else (k,)
    words = [*mapping.format_options(), *args.column]
    if len(joint) > 1 and words:
        raise UsageError(
            f"--adapt: --column {words[0]} names the column of one tendon; the two of a pair need "
            "their standard names (proximal_tension_2_N, ...)"
        )
    tables = read_tables(
        args.data,
        [parse_column_names(words, tendon) for tendon in joint],
        args.drop_nonfinite,
        mapping=mapping,
        zero_errors=() if args.fit else ("distal_tension",),
    )
    table = tables[joint.index(k)]
    summary: dict[str, Any] = {"data": table.name, "samples": len(table.time)}
    summary["read_as"] = ReadSummary.from_table(table).to_json()
    if args.tendon is not None or len(tendons) > 1:
        summary["tendon"] = format_tendon_name(k, joints)
    if args.fit:
        try:
            fit = fit_sheath(table, args.length, blocked_tip=args.blocked_tip)
        except FitError as error:
            raise UsageError(f"{table.path}, --fit: {error}") from error
        tendon = build_tendon_config(fit)
        if args.save is not None:
            save(args.save, fit, tendon, table, args.rig)
        summary["fit"] = {
            "method": fit.method,
            "parameters": {name: p._asdict() for name, p in fit.parameters.items()},
            "length": tendon.length,
            "accept": fit.accept,
            "reason": fit.reason,
        }
    else:
        chosen = [choose_tendon(n, tendons, joints, files) for n in joint]
        if not tendons:
            chosen = [
                complete_tendon_model(tendon_table, rows, args.length)
                for tendon_table, rows in zip(chosen, tables, strict=True)
            ]
        tendon = chosen[joint.index(k)]
    clean = remove_spikes(table)
    estimates = Estimator(tendon.build_model()).run(clean)
    summary["model"] = as_tree(tendon)
    if args.adapt:
        fixed = compare_with_bench(estimates, clean, tendon)
        estimates, summary["adaptation"] = adapt(chosen, tables, joint, k)
        summary["adaptation"]["fixed_K_error"] = fixed
    if tendon.model_file is not None:
        summary["effects"] = model_files.describe_effects(tendon)
    summary["spikes"] = list_spikes(clean, table)
    summary["force_error"] = compare_with_bench(estimates, clean, tendon)
    summary["travel_contradicts"] = has_contradictory_travel(tendon, clean, summary["force_error"])
    summary["doubts"] = list_warnings(clean, tendon, summary)
    summary["status"] = {
        str(flag.name).lower(): float(np.mean(estimates.status & flag != 0))
        for flag in online.Status
        if flag
    }
    summary["phase"] = {
        name: float(np.mean(estimates.phase == k)) for k, name in enumerate(PHASE_NAMES)
    }
    if args.out is not None:
        write_table(args.out, table.columns(k + 1) | build_columns(estimates, k + 1))
    write_summary(args.json, summary)
    print("\n".join(format_report(summary)))
    return 0


def adapt(
    tendons: Sequence[TendonConfig], tables: Sequence[MeasuredTable], joint: tuple[int, ...], k: int
) -> tuple[online.Estimates, dict[str, Any]]:
    """Return the estimates of tendon `k` of a joint with adaptation, and what became of K."""
    models, tensions, travels, loops = [tendon.build_model() for tendon in tendons], [], [], []
    for number, table in zip(joint, tables, strict=True):
        clean = remove_spikes(table)
        if clean.proximal_displacement is None:
            name = format_numbered_name("proximal_displacement_m", number + 1)
            raise UsageError(f"{table.path}, --adapt: needs {name}; tensions alone do not tell K")
        tensions.append(clean.proximal_tension)
        travels.append(clean.proximal_displacement)
        loop = get_loop_tension(table, number + 1)
        loops.append(np.full((len(table.time), 2), np.nan) if loop is None else loop)
    time = tables[0].time
    if len(models) == 2:
        pair = models[0], models[1]
        columns = (np.stack(rows, 1) for rows in (tensions, travels, loops))
        runs = run_adapting_pair(pair, time, *columns)
        run = runs[joint.index(k)]
    else:
        run = run_adapting(models[0], time, tensions[0], travels[0], loops[0])
    bounds = FACTOR_MIN * run.K[0], FACTOR_MAX * run.K[0]
    is_open = (run.K_low <= bounds[0] * (1.0 + 1e-6)) & (run.K_high >= bounds[1] * (1.0 - 1e-6))
    return run.estimates, {
        "K_calibrated": float(run.K[0]),
        "K": float(run.K[-1]),
        "K_low": float(run.K_low[-1]),
        "K_high": float(run.K_high[-1]),
        "changed_at_s": float(time[run.adapted_from]) if run.adapted_from >= 0 else None,
        "pieces": run.pieces,
        "contradictions": run.contradictions,
        "undecided": float(is_open.mean()),
    }


def check_options(args: argparse.Namespace) -> None:
    """Raise `UsageError` for conflicting options; a recording has its own config, if no other."""
    if not (args.config or args.fit or args.calibration or args.model) and is_recording(args.data):
        args.config = args.data
    load_models = args.config is not None or bool(args.overrides)
    ways = [args.fit, args.calibration is not None, load_models]
    if args.fit and args.model:
        raise UsageError("--model: conflicts with --fit; use one of them")
    if sum(ways) > 1 or not (any(ways) or args.model):
        raise UsageError(
            "no model of the sheath; give one of --fit (needs a distal tension in the data), "
            "--calibration FILE, and --config FILE, or --model FILE"
        )
    if not args.fit and (args.save is not None or args.blocked_tip):
        raise UsageError("--save, --blocked-tip: require --fit")
    if args.fit and args.adapt:
        raise UsageError("--adapt: conflicts with --fit; it begins with a model from before")
    if not 0.0 < args.length <= LENGTH_MAX:
        raise UsageError(f"--length {args.length:g}: must be above 0 and at most {LENGTH_MAX:g} m")
    if args.rig and args.save is None:
        raise UsageError("--rig: requires --save")


def choose_tendon(
    k: int, tendons: Sequence[TendonConfig], joints: JointTendons, files: model_files.ModelFiles
) -> TendonConfig:
    """Return tendon `k`, from 0, with its model file if there are any; a single one is for all."""
    if not files:
        return tendons[k if len(tendons) > 1 else 0]
    count = max(sum(map(len, joints)), len(tendons), k + 1)
    models = list(tendons) * count if len(tendons) == 1 else list(tendons)
    tendon = model_files.apply_model_files(models or [None] * count, joints, files)[k]
    if tendon is None:
        raise UsageError(f"--model: has none for tendon {format_tendon_name(k, joints)}")
    return tendon


def complete_tendon_model(
    tendon: TendonConfig, table: MeasuredTable, length: float
) -> TendonConfig:
    """Return a tendon from a model file alone, with a length [m] and the noise of a record."""
    try:
        completed = model_files.set_sheath_length(tendon, length)
        return model_files.set_noise_from_data(
            completed, table.proximal_tension, table.proximal_displacement
        )
    except ValueError as error:
        raise UsageError(f"{table.path}, --length {length:g}: {error}") from error


def has_contradictory_travel(
    tendon: TendonConfig, table: Samples, error: dict[str, Any] | None
) -> bool:
    """Return whether the estimate without travel would be far better."""
    if error is None or table.proximal_displacement is None:
        return False
    by_tension = Estimator(tendon.build_model()).run(table._replace(proximal_displacement=None))
    without = compare_with_bench(by_tension, table, tendon)
    return (
        without is not None
        and error["rmse_N"] > 2.0 * without["rmse_N"] + 0.01 * error["full_scale_N"]
    )


def list_warnings(clean: Samples, tendon: TendonConfig, summary: dict[str, Any]) -> list[str]:
    """Return what is wrong with the data, or contradicts the model; one line each."""
    out = list(find_channel_faults(clean))
    error = summary["force_error"]
    pulled = float(np.nanmax(clean.proximal_tension)) >= FULL_SCALE_SIGMAS * tendon.tension_noise
    if error is not None and pulled and "fit" not in summary:
        text = find_contradiction(error["rmse_percent"] / 100.0, error["inside_interval"])
        remedy = (
            "check that the model is of this tendon and that it is calibrated anew since it was "
            "moved, or see what `teleop diagnose` finds"
        )
        out += [f"data and model contradict: {text}; {remedy}"] if text else []
    if clean.proximal_displacement is not None and clean.distal_displacement is not None:
        stretch = clean.proximal_displacement - clean.distal_displacement
        by_tension = Estimator(tendon.build_model()).run(clean._replace(proximal_displacement=None))
        out += [text] if (text := find_stretch_slip(stretch, by_tension.elongation)) else []
    return out


def list_spikes(clean: Samples, table: MeasuredTable) -> dict[str, dict[str, float]]:
    """Return the number of spikes of each channel, and the largest."""
    out: dict[str, dict[str, float]] = {}
    for name, signal in collect_signals(clean).items():
        measured = getattr(table, name)
        spikes = np.flatnonzero(np.isnan(signal) & ~np.isnan(measured))
        measured = measured[spikes]
        out[name] = {"count": len(spikes)}
        if len(spikes):
            largest = int(np.abs(measured).argmax())
            out[name] |= {
                "largest": float(measured[largest]),
                "time_s": float(table.time[spikes[largest]]),
            }
    return out


def load_models(args: argparse.Namespace) -> tuple[tuple[TendonConfig, ...], JointTendons]:
    """Return the models of the calibration file or the config, and the rig's joints.

    A single model is for all tendons; none with model files only; joints are empty if unknown.
    """
    if args.calibration is not None:
        calibration = calibration_file.load(args.calibration)
        return calibration.tendons, calibration.joints
    if args.config is None and not args.overrides:
        return (), ()
    config = load(args.config, SlaveConfig, "slave", args.overrides)
    if is_recording(args.config) and config.initialise.at_start:
        raise UsageError(
            f"{args.config}: the session calibrated its rig at its start, and the recording has "
            "not got the result; give --calibration FILE or --fit"
        )
    if isinstance(config.calibration, Path):
        try:
            calibration = calibration_file.load(config.calibration)
        except UsageError as error:
            origin = f"; {args.config} was recorded with it" if is_recording(args.config) else ""
            raise UsageError(f"{error}{origin}; --calibration FILE names another") from error
        return calibration.tendons, calibration.joints
    joints = get_joint_tendons(config)
    count = sum(map(len, joints)) or max(len(config.tendons), 1)
    return load_tendon_configs(config, count), joints


def is_recording(path: Path | None) -> bool:
    """Return whether this is a recording of a session, which has its config."""
    return (
        path is not None and path.suffix == RECORDING_SUFFIX and path.is_file() and not is_bag(path)
    )


def read_recorded_joints(path: Path) -> JointTendons:
    """Return the tendons of the joints in a recording; empty if its config does not tell."""
    if not is_recording(path):
        return ()
    try:
        return get_joint_tendons(load(path, SlaveConfig, "slave"))
    except UsageError:  # of another version
        return ()


def get_joint_tendons(config: SlaveConfig) -> JointTendons:
    """Return the tendons of the joints of a configured rig; empty if its config does not tell."""
    if not isinstance(config.rig, SimulatedRigConfig | HardwareRigConfig):
        return ()
    return number_joint_tendons([len(joint.tendons) for joint in config.rig.joints])


def select_tendon(word: str | None, joints: JointTendons, count: int) -> int:
    """Return the tendon of `--tendon`, from 0: 1a, 1b, 2a, ... or 1, 2, 3, ...

    `count` is the number of models; a single one is for all tendons.
    """
    tendon_count = sum(map(len, joints)) or (count if count > 1 else MAX_TENDONS)
    names = model_files.map_tendon_names(joints, tendon_count)
    if word is None:
        return 0
    if word not in names:
        raise UsageError(f"--tendon {word}: must be one of {', '.join(names)}")
    return names[word]


def format_tendon_name(k: int, joints: JointTendons) -> str:
    """Return the name of tendon `k`, from 0: joint and side if known."""
    for number, tendons in enumerate(joints, start=1):
        if k in tendons:
            return f"{number}{'ab'[tendons.index(k)]}"
    return str(k + 1)


def compare_with_bench(
    estimates: online.Estimates, table: Samples, tendon: TendonConfig
) -> dict[str, Any] | None:
    """Return the error against the measured distal tension, None without one."""
    if table.distal_tension is None:
        return None
    score = Score([tendon.build_model()])
    score.add_columns(estimates.distal_tension, estimates.low, estimates.high, table.distal_tension)
    return score.summarise()


def build_columns(estimates: online.Estimates, number: int = 1) -> dict[str, Any]:
    """Return the estimates of tendon 1, 2, ... as columns of a table."""
    columns = {
        "distal_tension_estimate_N": estimates.distal_tension,
        "distal_tension_low_N": estimates.low,
        "distal_tension_high_N": estimates.high,
        "elongation_estimate_m": estimates.elongation,
        "distal_displacement_estimate_m": estimates.distal_displacement,
        "front_m": estimates.front,
    }
    codes = {"phase": estimates.phase, "status": estimates.status}
    suffix = f"_{number}" if number > 1 else ""
    return {format_numbered_name(name, number): column for name, column in columns.items()} | {
        name + suffix: column for name, column in codes.items()
    }


def build_tendon_config(fit: SheathFit) -> TendonConfig:
    """Return a fitted tendon for a calibration file."""
    model = fit.model
    return TendonConfig(
        effective_friction=fit.K.value,
        length=fit.sheath.length,
        axial_stiffness=fit.sheath.axial_stiffness,
        tension_noise=model.tension_noise,
        displacement_noise=model.displacement_noise,
        friction_error=model.friction_error,
    )


def save(path: Path, fit: SheathFit, tendon: TendonConfig, table: MeasuredTable, rig: str) -> None:
    """Write a calibration for `--calibration` and `slave.calibration`."""
    ends = ", ".join(f"{n} {p.low:.4g} to {p.high:.4g}" for n, p in fit.parameters.items())
    calibration = Calibration(
        tendons=(tendon,),
        rig=rig,
        method=f"{fit.method}; 95 % intervals: {ends}",
        source=f"{table.path.name}: {format_read_summary(ReadSummary.from_table(table).to_json())}",
        accepted=fit.accept,
        remark=fit.reason,
    )
    calibration_file.save(path, calibration)


def format_report(summary: dict[str, Any]) -> list[str]:
    """Return the summary as lines of text."""
    lines = [f"{summary['data']}: {summary['samples']} samples"]
    lines += (
        [f"read as   {format_read_summary(summary['read_as'])}"] if "read_as" in summary else []
    )
    if "tendon" in summary:
        lines.append(f"tendon    {summary['tendon']} (select with --tendon)")
    if "fit" in summary:
        fit = summary["fit"]
        lines.append(f"fit       {fit['method']}")
        for name, p in fit["parameters"].items():
            lines.append(
                f"          {name} = {p['value']:.4g} (95 %: {p['low']:.4g} to {p['high']:.4g})"
            )
        length, EA = fit["length"], summary["model"]["axial_stiffness"]
        assumption = "" if "EA" in fit["parameters"] else " assumed"
        lines.append(
            f"          EA = {EA:.4g} N{assumption} for a length of {length:g} m (--length): "
            f"EA and L only enter as EA/L = {EA / length:.4g} N/m"
        )
        lines.append(
            f"          {'accepted' if fit['accept'] else 'NOT accepted'}: {fit['reason']}"
        )
    lines += [f"model     {sentence}" for sentence in summary.get("effects", ())]
    if "adaptation" in summary:
        lines += format_adaptation(summary["adaptation"])
    lines.append(f"force     {format_force_error(summary['force_error'])}")
    for name, spikes in summary["spikes"].items():
        if spikes["count"]:
            unit = LINEAR.get_unit(name)
            lines.append(
                f"          {spikes['count']:g} single-sample spikes of {name.replace('_', ' ')} "
                f"left out, the largest {spikes['largest']:.6g} {unit} at "
                f"{spikes['time_s']:.6g} s: check the sensor's cable"
            )
    lines += [f"WARNING   {doubt}" for doubt in summary["doubts"]]
    if summary["travel_contradicts"]:
        lines.append(
            "WARNING   the displacement contradicts the tension: without it the estimate is far "
            "better. Check that its unit is metres, positive while pulling."
        )
    flags = [
        f"{name.replace('_', ' ')} {share:.0%}"
        for name, share in summary["status"].items()
        if share
    ]
    lines.append("status    " + (", ".join(flags) or "no warnings"))
    return lines


def format_adaptation(adaptation: dict[str, Any]) -> list[str]:
    """Return what became of K as lines of text."""
    before, K = adaptation["K_calibrated"], adaptation["K"]
    interval = f"{adaptation['K_low']:.3g} to {adaptation['K_high']:.3g}"
    pieces, undecided = adaptation["pieces"], adaptation["undecided"]
    if adaptation["changed_at_s"] is not None:
        lines = [
            f"adapted   the shape changed before {adaptation['changed_at_s']:.6g} s: K from "
            f"{before:.3g} to {K:.3g} ({interval}) at the end"
        ]
    else:
        lines = [f"adapted   K stays {K:.3g} ({interval}): no evidence excludes it"]
    lines.append(
        f"          {pieces} pieces of evidence, {adaptation['contradictions']} with a tip that "
        f"moved far; K unknown within its bounds in {undecided:.0%} of time"
    )
    if undecided > 0.5 or not pieces:
        lines.append(
            "WARNING   adaptation cannot decide: the tip moves by itself, or too little is pulled; "
            "calibrate if in doubt"
        )
    if adaptation["fixed_K_error"] is not None:
        lines.append(f"          fixed K: {format_force_error(adaptation['fixed_K_error'])}")
    return lines
