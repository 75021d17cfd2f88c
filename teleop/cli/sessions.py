"""List the sessions that you have running on this machine.

  teleop sessions                  name, process, start, config file and endpoints
  teleop sessions --json FILE      the same as JSON

`teleop view`, `stop`, `set`, `record`, `ros` and `impair` take the only one, or the one that
`--session NAME` names. A session of separate processes (`teleop slave`, `teleop master`) or on
other machines is not listed: its config file names it.
"""

import argparse

from teleop.config.options import add_options
from teleop.runtime.process import write_summary
from teleop.session.running_sessions import list_sessions


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop sessions`."""
    add_options(parser, "--json")


def main(args: argparse.Namespace) -> int:
    """Print the running sessions; returns the exit code."""
    entries = list_sessions()
    write_summary(args.json, {"sessions": [entry._asdict() for entry in entries]})
    for entry in entries:
        print(
            f"{entry.session}  process {entry.pid}  since {entry.began}  "
            f"{', '.join(entry.endpoints)}  {entry.config or 'no config file'}"
        )
    if not entries:
        print("no sessions running")
    return 0
