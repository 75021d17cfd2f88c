"""Command-line options that several commands share, each declared once."""

import argparse
from pathlib import Path
from typing import Any, Literal, cast, get_args

from teleop.runtime.output_file import OutputFile, OutputFolder
from teleop.runtime.process import parse_seconds

ALLOW_IMPORTS = "--allow-imports"
TABLE_OPTIONS = ("--column", "--mapping", "--rate", "--decimal", "--run", "--drop-nonfinite")
ViewMode = Literal["native", "web", "rrd", "none"]


class ViewOutput(OutputFile):
    """A mode of the view, or a Rerun file to be written: the `type` of an argument."""

    def __call__(self, text: str) -> ViewMode | Path:
        """Return the mode, or the path of the file."""
        for mode in get_args(ViewMode):
            if text == mode:
                return cast(ViewMode, mode)
        if Path(text).suffix == ".rrd":
            return cast(Path, super().__call__(text))
        raise argparse.ArgumentTypeError(
            f"{text!r} is none of {', '.join(get_args(ViewMode))}, nor a file name that ends in "
            ".rrd"
        )


view_mode = ViewOutput()


_OPTIONS: dict[str, dict[str, Any]] = {
    ALLOW_IMPORTS: {
        "action": "store_true",
        "help": "let config and model files name any code, as package.module:Name, which is run; "
        "without it only entry points of installed packages",
    },
    "--calibration": {"type": Path, "metavar": "FILE", "help": "calibration of the sheaths"},
    "--column": {
        "action": "append",
        "default": [],
        "metavar": "NAME=COLUMN[UNIT]",
        "help": "what the data call proximal_tension, proximal_displacement, distal_tension, "
        "distal_displacement or time, e.g. --column proximal_tension=T_in; with its unit, 'q[mm]', "
        "its sign, 'q[-1 mm]', or its scale and zero, 'cell[12.5 N, zero 0.3]' of volts",
    },
    "--config": {
        "type": Path,
        "metavar": "FILE",
        "help": "config file (YAML; default built-in values)",
    },
    "--decimal": {
        "choices": ("point", "comma"),
        "help": "sign of decimals in a text table, where its numbers do not tell",
    },
    "--drop-nonfinite": {
        "action": "store_true",
        "help": "leave out rows without a finite time or reading at the housing, and single values "
        "at the tip that are not finite",
    },
    "--duration": {"type": parse_seconds, "metavar": "S", "help": "end after S seconds"},
    "--insecure": {
        "dest": "overrides",
        "action": "append_const",
        "const": "link.insecure=true",
        "default": [],
        "help": "plaintext: whoever reaches the endpoints may move the robot",
    },
    "--jobs": {
        "type": int,
        "metavar": "N",
        "help": "processes that work in parallel (default one for each processor)",
    },
    "--json": {
        "type": OutputFile(),
        "metavar": "FILE",
        "help": "write the results to FILE as JSON",
    },
    "--mapping": {
        "type": Path,
        "metavar": "FILE",
        "help": "how tables are to be read: columns, units, scales, time format, as YAML "
        "(docs/reference/data-format.md)",
    },
    "--model": {
        "action": "append",
        "default": [],
        "metavar": "[1a=]FILE",
        "help": "model.yaml of `teleop diagnose --out`; replaces friction and stiffness from "
        "config or calibration; 1a=FILE for one tendon of several",
    },
    "--out": {"type": OutputFolder(), "metavar": "DIR", "help": "folder for the report"},
    "--quick": {"action": "store_true", "help": "less accurate, in less time"},
    "--rate": {
        "type": float,
        "metavar": "HZ",
        "help": "samples per second, of data without times, or with numbers of samples",
    },
    "--run": {
        "type": int,
        "metavar": "N",
        "help": "the run of a file of several, from 1 (`teleop data show` lists them); 0: all rows "
        "are one run",
    },
    "--session": {
        "metavar": "NAME",
        "help": "a session of `teleop sessions` (default the only one that is running)",
    },
    "--set": {
        "dest": "overrides",
        "action": "append",
        "default": [],
        "metavar": "KEY=VALUE",
        "help": "override one value of the config, e.g. --set link.master=127.0.0.1:9000",
    },
    "--validate": {
        "nargs": "+",
        "action": "extend",
        "default": [],
        "type": Path,
        "metavar": "DATA",
        "help": "further data, to be predicted and not fitted",
    },
    "--view": {
        "type": view_mode,
        "metavar": "{native,web,rrd,none,FILE.rrd}",
        "help": "a window, a page for a browser on this machine, a Rerun file (with a name of its "
        "own, or FILE.rrd), or nothing at all (default native with a screen, web without)",
    },
}


def add_options(parser: argparse.ArgumentParser, *names: str) -> None:
    """Add shared options to a command; `--set` is read as `args.overrides`."""
    for name in names:
        add_option(parser, name)


def add_option(
    parser: argparse.ArgumentParser | argparse._ArgumentGroup,
    name: str,
    detail: str = "",
    **changes: Any,
) -> None:
    """Add one shared option; `detail` is added to its help, `changes` to its declaration."""
    option = _OPTIONS[name]
    text = f"{option['help']}: {detail}" if detail else option["help"]
    parser.add_argument(name, **option | {"help": text} | changes)
