"""Repeat the experiment of Phee et al. 2009 on simulated rigs.

  python -m studies.paper
  python -m studies.paper --sheaths 12 --seed 7 --out results

Initialisation, then pull to 20 N, release to 5 N and pull to 20 N, then nested reversals: with a
sheath as the paper's, and with random ones. Two readings of the paper's method and ours estimate
force and elongation at the tip from the housing; the tip's true values judge them. Tables are
printed, figures written to --out (studies/results/experiment.md). The same seed gives the same
numbers. Takes 5 minutes on two processors.
"""

from pathlib import Path

from studies.paper import report
from studies.paper.bench import Specimen, draw_sheaths
from studies.paper.study import (
    Demonstration,
    Outcome,
    demonstrate_specimen,
    judge_session,
    run_experiment,
)
from studies.testbed.command import parse_options
from studies.testbed.parallel import map_in_parallel
from teleop.runtime.machine import count_processors
from teleop.runtime.status_line import Progress


def main() -> None:
    """Run the study."""
    args = parse_options(
        __doc__,
        sheaths=(40, "number of random sheaths"),
        seed=(1, "of sheaths and noise"),
        jobs=(count_processors(), "processes"),
        out=(Path, "folder for the figures"),
    )
    if args.out is not None:
        args.out.mkdir(parents=True, exist_ok=True)
    shown, outcomes = run_experiments(args.sheaths, args.seed, args.jobs)
    print(report.format_tables(shown.outcome, outcomes, args.seed))
    if args.out is not None:
        from studies.paper import figures

        figures.write_figures(shown, outcomes, args.out)


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


def _run_task(task: tuple[Specimen | None, int]) -> Demonstration | Outcome:
    specimen, seed = task
    if specimen is None:
        return demonstrate_specimen(seed)
    return judge_session(run_experiment(specimen, seed))


if __name__ == "__main__":
    main()
