"""Repeat the experiment of Phee et al. 2009 on simulated rigs.

  python -m studies.paper
  python -m studies.paper --sheaths 12 --seed 7 --out results

Initialisation, then pull to 20 N, release to 5 N and pull to 20 N, then nested reversals: with a
sheath as the paper's, and with random ones. Two readings of the paper's method and ours estimate
force and elongation at the tip from the housing; the tip's true values judge them. With --out the
tables, the figures and a page that shows all are written there (studies/results/experiment.md). The
same seed gives the same figures. Takes 5 minutes on two processors.
"""

import argparse
from pathlib import Path

from studies.paper import report
from studies.paper.bench import Specimen, draw_sheaths
from studies.paper.methods import METHODS, OURS
from studies.paper.study import (
    SPECIMEN,
    Demonstration,
    Outcome,
    demonstrate_specimen,
    judge_session,
    run_experiment,
)
from teleop.cli.html_page import Page
from teleop.config.options import add_option, add_options
from teleop.errors import UsageError
from teleop.runtime.output_file import make_folder
from teleop.runtime.parallel import count_processors, map_in_parallel
from teleop.runtime.process import write_summary, write_text_file
from teleop.runtime.status_line import Progress

MOST_SHEATHS = 1000
TITLE = "The experiment of Phee et al. 2009, repeated"
UNITS = "Errors in % of full scale, the largest true value of the run."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "--sheaths", type=int, default=40, metavar="N", help="number of random sheaths (default 40)"
    )
    parser.add_argument(
        "--seed", type=int, default=1, metavar="N", help="seed of sheaths and noise (default 1)"
    )
    add_options(parser, "--out", "--json")
    add_option(parser, "--jobs", default=count_processors())
    parser.add_argument(
        "--figures",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="draw figures into --out (default yes)",
    )


def main(args: argparse.Namespace) -> int:
    """Run the command."""
    for name, least, most in (("sheaths", 1, MOST_SHEATHS), ("seed", 0, 2**31), ("jobs", 1, 256)):
        if not least <= getattr(args, name) <= most:
            raise UsageError(f"--{name} {getattr(args, name)}: must be {least} to {most}")
    if args.out is not None:
        make_folder(args.out, "index.html")
    shown, outcomes = run_experiments(args.sheaths, args.seed, args.jobs)
    tables = format_tables(shown, outcomes, args.seed)
    print(tables)
    tree = report.build_tree(shown.outcome, outcomes, args.seed)
    write_summary(args.json, tree)
    if args.out is not None:
        write_summary(args.out / "table.json", tree)
        write_text_file(args.out / "table.md", tables + "\n", "the tables")
        captions = {}
        if args.figures:
            from studies.paper import figures

            captions = figures.write_figures(shown, outcomes, args.out)
        page = build_page(shown, outcomes, args.seed, args.out, captions)
        write_text_file(args.out / "index.html", page, "the page")
        print(f"\nwritten: {args.out / 'index.html'}")
    return 0


def run_experiments(sheaths: int, seed: int, jobs: int) -> tuple[Demonstration, list[Outcome]]:
    """Return the sheath of the figures in full, and how the random ones came out."""
    tasks = [(specimen, seed) for specimen in (None, *draw_sheaths(sheaths, seed))]
    done: list[Demonstration | Outcome] = []
    with Progress() as progress:
        for result in map_in_parallel(_run_task, tasks, jobs):
            done.append(result)
            progress("sheaths", len(done) / len(tasks))
    (shown,) = (one for one in done if isinstance(one, Demonstration))
    return shown, [one for one in done if isinstance(one, Outcome)]


def format_tables(shown: Demonstration, outcomes: list[Outcome], seed: int) -> str:
    """Return all tables as Markdown."""
    parts = [f"# {TITLE}", report.format_summary(outcomes), UNITS]
    parts += [f"## A sheath as the paper's: {SPECIMEN.describe()}"]
    parts += ["Largest / average.", report.build_phase_table(shown.outcome).to_markdown()]
    parts += [f"## {len(outcomes)} random sheaths, seed {seed}"]
    parts += [report.build_spread_table(outcomes).to_markdown()]
    for method in METHODS:
        worst = "\n".join(f"- {line}" for line in report.list_worst_sheaths(outcomes, method, seed))
        parts += [f"### Worst of {method}, by the largest error of force", worst]
    return "\n\n".join(parts)


def build_page(
    shown: Demonstration, outcomes: list[Outcome], seed: int, folder: Path, captions: dict[str, str]
) -> str:
    """Return the page; the figures, by file name in `folder`, have captions."""
    page = Page(TITLE)
    page.add_text(report.format_summary(outcomes))
    page.add_text(UNITS)
    page.add_heading(f"A sheath as the paper's: {SPECIMEN.describe()}")
    page.add_text("Largest / average.")
    page.add_table(report.build_phase_table(shown.outcome), mark="")
    page.add_heading(f"{len(outcomes)} random sheaths, seed {seed}")
    page.add_table(report.build_spread_table(outcomes), mark=OURS)
    for method in METHODS:
        page.add_text(f"Worst of {method}, by the largest error of force:")
        page.add_points(report.list_worst_sheaths(outcomes, method, seed))
    page.add_heading("Figures")
    for file, caption in captions.items():
        page.add_image((folder / file).read_bytes(), caption)
    return page.render()


def _run_task(task: tuple[Specimen | None, int]) -> Demonstration | Outcome:
    specimen, seed = task
    return (
        demonstrate_specimen(seed)
        if specimen is None
        else judge_session(run_experiment(specimen, seed))
    )
