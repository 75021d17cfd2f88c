"""Diagnosis of many files side by side, each by itself (`teleop diagnose --jobs`).

The processes are joblib's: with `joblib.parallel_config` around `diagnose_separately`, those of a
cluster. They share the folder of compiled code, so that none compiles what another has.
"""

import argparse
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from estimator.diagnosis.travel_diagnosis import is_travel_pair
from estimator.report_table import Table
from teleop.cli.diagnose import diagnosis_run, travels
from teleop.errors import TeleopError, UsageError
from teleop.ros.bag_table import is_bag
from teleop.runtime.machine import count_processors
from teleop.runtime.process import write_summary
from teleop.runtime.status_line import Progress

_OF_ONE_BENCH = ("validate", "calibration", "config", "supplement", "leave_one_file_out", "cause")


class FileOutcome(NamedTuple):
    """What came of one file."""

    path: Path
    report: dict[str, Any]  # as in `report.json`; empty after an error
    seconds: float
    error: str = ""

    @property
    def words(self) -> tuple[str, str, str]:
        """The verdict or the error, the causes with their rivals, and the share that is left."""
        if self.error:
            return self.error, "", ""
        causes = " + ".join(self.report.get("cause", ()))  # of two travels alone there are none
        rivals = "".join(f" | {name}" for name in self.report.get("ambiguous_with", ()))
        return self.report["verdict"], causes + rivals, f"{self.report['left']:.1%}"


def run(args: argparse.Namespace) -> int:
    """Diagnose each file and say what came of it; the exit code is 2 if one could not be."""
    for name in _OF_ONE_BENCH:
        if getattr(args, name):
            option = name.replace("_", "-")
            raise UsageError(f"--{option}: is for files of one bench; --jobs takes each by itself")
    if args.jobs < 1:
        raise UsageError(f"--jobs {args.jobs}: must be 1 or more")
    paths = find_files(args.data)
    _import_joblib()
    if args.out is not None:
        first: dict[str, Path] = {}
        for path in paths:
            if (other := first.setdefault(path.name, path)) is not path:
                raise UsageError(f"--out: {other} and {path} have one name; rename one of them")
    outcomes: list[FileOutcome] = []
    with Progress() as progress:
        progress(f"diagnosing {len(paths)} files", 0.0)
        for outcome in diagnose_separately(args, paths, args.jobs):
            outcomes.append(outcome)
            progress.end()
            words = ", ".join(filter(None, outcome.words))
            print(f"{outcome.path}: {words}, {outcome.seconds:.0f} s", flush=True)
            progress(f"{len(paths) - len(outcomes)} files left", len(outcomes) / len(paths))
    outcomes.sort(key=lambda outcome: paths.index(outcome.path))
    rows = tuple((str(outcome.path), *outcome.words) for outcome in outcomes)
    print("\n" + Table(("file", "verdict", "cause", "left of the error"), rows).to_markdown())
    files = [
        {"file": str(each.path), "error": each.error or None, "report": each.report or None}
        for each in outcomes
    ]
    write_summary(args.json, {"files": files})
    return UsageError.exit_code if any(outcome.error for outcome in outcomes) else 0


def find_files(paths: Sequence[Path]) -> list[Path]:
    """Return files, and those in folders that are no bags; `UsageError` if a folder has none."""
    found: list[Path] = []
    for path in paths:
        if not path.is_dir() or is_bag(path):
            found.append(path)
            continue
        inside = sorted(file for file in path.iterdir() if file.is_file() and file.name[0] != ".")
        if not inside:
            raise UsageError(f"{path}: has no files")
        found += inside
    return list(dict.fromkeys(found))


def diagnose_separately(
    args: argparse.Namespace, paths: Sequence[Path], jobs: int | None = None
) -> Iterator[FileOutcome]:
    """Yield what comes of each file as it ends, in `jobs` processes or those of `parallel_config`.

    Each writes its report into a folder of its name within `--out`.
    """
    joblib = _import_joblib()
    workers = max(1, count_processors() // (jobs or count_processors()))
    work = joblib.delayed(_diagnose_file)
    pool = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")
    yield from pool(work(args, path, workers) for path in paths)


def _diagnose_file(args: argparse.Namespace, path: Path, workers: int) -> FileOutcome:
    begin_s = time.monotonic()
    own_args = argparse.Namespace(**vars(args))
    own_args.data, own_args.out = [path], args.out and args.out / path.name
    if args.allow_imports:
        from teleop.config.extensions import allow_imports

        allow_imports()
    report: dict[str, Any] = {}
    error = ""
    try:
        data = diagnosis_run.read_files(own_args)
        if is_travel_pair(data.fitted[0]):
            report = travels.write_report(own_args, data.fitted)[1]
        else:
            content, report = diagnosis_run.diagnose_files(own_args, data, workers=workers)
            diagnosis_run.write_report(own_args, content, report)
    except TeleopError as failure:
        error = str(failure)
    except Exception as failure:  # of whatever kind: the other files go on
        error = f"{path}: {type(failure).__name__}: {failure}"
    return FileOutcome(path, report, time.monotonic() - begin_s, error)


def _import_joblib() -> ModuleType:
    try:
        import joblib
    except ModuleNotFoundError:
        raise UsageError(
            "--jobs: needs joblib: pip install 'tendon-teleop[jobs]', or give one file at a time"
        ) from None
    module: ModuleType = joblib
    return module
