"""Print a script by which the shell completes `teleop`: commands, options, choices, files.

  teleop completion bash > ~/.local/share/bash-completion/completions/teleop
  teleop completion zsh > ~/.zfunc/_teleop       with fpath+=~/.zfunc before compinit in ~/.zshrc
  teleop completion fish > ~/.config/fish/completions/teleop.fish
  source <(teleop completion bash)               in this terminal only; zsh: eval "$(...)"

After `--set` it completes the keys of a config. The script has all words in it, so that nothing is
started at a press of Tab: print it again after an update.
"""

import argparse
from pathlib import Path
from typing import Any

from teleop.cli import commands
from teleop.cli.config.keys import describe_keys
from teleop.cli.config.reference import list_sections
from teleop.errors import UsageError
from teleop.runtime.output_file import NewFolder, OutputFile, OutputFolder, SharedFolder

SHELLS = ("bash", "zsh", "fish")

_SET_KEYS = {
    "bash": "_teleop_set_keys() {{ compgen -W '{words}' -- \"$1\"; }}",
    "zsh": "_teleop_set_keys() {{ compadd -S '' -- {words}; }}",
    "fish": "function _teleop_set_keys; printf '%s\\n' {words}; end",
}
"""Functions that give the keys of a config, each with `=` behind it."""

_NO_SPACE = """
_teleop() {
  _shtab_teleop
  [[ ${COMPREPLY[0]-} == *= ]] && compopt -o nospace 2>/dev/null
  return 0
}
complete -o bashdefault -F _teleop teleop
"""
"""Ends the script of bash: a value follows a key immediately."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `teleop completion`."""
    parser.add_argument("shell", choices=SHELLS, metavar="SHELL", help="bash, zsh or fish")


def main(args: argparse.Namespace) -> int:
    """Print the script; returns the exit code."""
    print(build_script(args.shell))
    return 0


def build_script(shell: str) -> str:
    """Return the script for a shell; `UsageError` without the package that makes it."""
    try:
        import shtab
    except ModuleNotFoundError as error:
        raise UsageError(
            "needs the Python package shtab, new among the dependencies: pip install shtab"
        ) from error
    parser = commands.build_parser(None, described=True)
    _set_completers(parser)
    words = _list_set_words()
    functions: Any = {name: text.format(words=words) for name, text in _SET_KEYS.items()}
    script: str = shtab.complete(parser, shell, preamble=functions)
    return script + _NO_SPACE if shell == "bash" else script


def _list_set_words() -> str:
    """Return all keys that `--set` takes a value for; of lists those of the first item."""
    keys = dict.fromkeys(
        f"{section.path.replace('[]', '.0')}.{key.name}=".lstrip(".")
        for section in list_sections()
        for key in describe_keys(section.config)
        if not section.problem
    )
    return " ".join(sorted(keys))


def _set_completers(parser: argparse.ArgumentParser) -> None:
    """Say of each argument of a parser, and of those below it, what its values are."""
    import shtab

    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for inner in action.choices.values():
                _set_completers(inner)
        elif action.choices is not None:
            action.choices = list(action.choices)  # shtab takes a mapping for sub-commands
        elif action.dest == "overrides" and action.nargs != 0:
            function = dict.fromkeys(("bash", "zsh"), "_teleop_set_keys")
            action.complete = function | {"fish": "(_teleop_set_keys)"}  # type: ignore[attr-defined]
        elif isinstance(action.type, OutputFolder | NewFolder | SharedFolder) or (
            action.type is Path and action.metavar == "DIR"
        ):
            action.complete = shtab.DIRECTORY  # type: ignore[attr-defined]
        elif action.type is Path or isinstance(action.type, OutputFile):
            action.complete = shtab.FILE  # type: ignore[attr-defined]
