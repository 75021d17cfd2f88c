"""Transparency and stability of each coupling: `python -m studies.transparency`."""

import sys

from studies.transparency import command
from teleop.cli.commands import run_program

if __name__ == "__main__":
    sys.exit(run_program("python -m studies.transparency", command))
