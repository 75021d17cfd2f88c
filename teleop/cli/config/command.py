"""Show the config of a session, and all keys there are.

  teleop config show                                      the defaults, with what each may be
  teleop config show configs/demo.yaml                    a file, with the line of each value
  teleop config show configs/demo.yaml --set rate_hz=500 --section slave.rig
  teleop config show recordings/demo.mcap                 what a recorded session ran with
  teleop config reference --section slave.gate            meaning, unit and range of each key
  teleop config reference --format md > keys.md

`show` prints a config file: each value, then as a comment where it comes from (file:line, --set,
default) and what is allowed. It checks the config as `teleop run` does, and starts nothing.
"""

import argparse
from pathlib import Path

from teleop.cli.config import reference, show
from teleop.config.loading import ConfigDocument
from teleop.config.options import add_options
from teleop.runtime.process import write_summary


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the actions of `teleop config`."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    shown = actions.add_parser("show", help="print a config, and where each value comes from")
    shown.add_argument(
        "file",
        type=Path,
        nargs="?",
        metavar="FILE",
        help="config file, or a recording (default built-in values)",
    )
    add_options(shown, "--set", "--json", "--allow-imports")
    listed = actions.add_parser("reference", help="print all keys: type, default, unit, meaning")
    listed.add_argument(
        "--format",
        choices=("text", "md"),
        default="text",
        help="text for a terminal (default), or Markdown",
    )
    for action in (shown, listed):
        action.add_argument("--section", metavar="KEY", help="only this part, as slave.rig")


def main(args: argparse.Namespace) -> int:
    """Print what is asked; returns the exit code."""
    if args.action == "reference":
        render = reference.render_text if args.format == "text" else reference.render_markdown
        print(render(args.section or ""), end="")
        return 0
    return _show(args)


def _show(args: argparse.Namespace) -> int:
    from teleop.launch.config import SessionConfig

    document = ConfigDocument.read(args.file, args.overrides)
    values = list(show.list_values(document, document.load(SessionConfig)))
    if args.section:
        values = show.select_section(values, args.section)
    write_summary(args.json, {"values": [value.as_json() for value in values]})
    print(f"# {args.file or 'defaults'}: value, where it comes from, what is allowed")
    print(show.format_values(values))
    return 0
