"""Repeat the experiment of Phee et al. 2009: `python -m studies.paper`."""

import sys

from studies.paper import command
from teleop.cli.commands import run_program

if __name__ == "__main__":
    sys.exit(run_program("python -m studies.paper", command))
