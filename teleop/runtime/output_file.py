"""What a command writes: named on the command line, checked before any work, never by accident.

An option that names an output has one of the classes below as its `type`. What exists is refused
unless `--force` is given, which `add_force_option` adds to every command with such an option. An
output that is an input of the same command, by another name or a link too, is refused always. Files
are written beside their name and renamed, so that an interrupted command leaves the old one.
"""

# ruff: noqa: ARG002 - one signature of `require` for all kinds of output

import argparse
import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from teleop.errors import UsageError

TABLE_SUFFIXES = (".csv", ".csv.gz", ".parquet")
FIGURE_SUFFIXES = (".png", ".pdf", ".svg")

FORCE_OPTION = "--force"


class OutputPath:
    """The `type` of an option that names an output; `require` is asked when all is parsed."""

    def __call__(self, text: str) -> Any:
        """Return the path, if something can be written there.

        Raises `argparse.ArgumentTypeError` if nothing can, or the name does not end as it must.
        """
        if not text:
            raise argparse.ArgumentTypeError("the name is empty")
        return Path(text)

    def require(self, path: Path, force: bool, inputs: list[Path]) -> None:
        """Raise `UsageError` if writing would overwrite anything that must not be."""
        for source in inputs:
            if is_same_file(source, path):
                alias = "" if str(source) == str(path) else f", as {source}"
                raise UsageError(f"is an input of this command too{alias}; name another file")


class OutputFile(OutputPath):
    """A file, new unless `--force`; its name ends in one of `suffixes`, if there are any."""

    def __init__(self, *suffixes: str) -> None:
        self.suffixes = suffixes

    def __call__(self, text: str) -> Any:
        """Return the path; found out now, not after an hour of running."""
        path = Path(text)
        try:
            if path.is_dir():
                raise argparse.ArgumentTypeError(f"{text!r} is a folder, not a file")
            if self.suffixes and not path.name.lower().endswith(self.suffixes):
                ends = ", ".join(self.suffixes)
                raise argparse.ArgumentTypeError(f"{text!r} must end in one of {ends}")
            if not is_special(path):
                partial = _build_partial_path(path.resolve())
                partial.touch()
                partial.unlink()
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise argparse.ArgumentTypeError(f"{text!r} cannot be written: {reason}") from error
        return path

    def require(self, path: Path, force: bool, inputs: list[Path]) -> None:
        """Raise `UsageError` for an existing file without `--force`, and for an input."""
        if is_special(path):
            return
        super().require(path, force, inputs)
        if path.exists() and not force:
            raise UsageError(f"exists; name another file, or replace it with {FORCE_OPTION}")


class UpdatedFile(OutputFile):
    """A file of ours that the command reads, checks and updates: existing is as it should be."""

    def require(self, path: Path, force: bool, inputs: list[Path]) -> None:
        """Raise `UsageError` for an input."""
        super().require(path, True, inputs)


class OutputFolder(OutputPath):
    """A folder of files, new or empty unless `--force`; `inside` it, if all go into one there."""

    def __init__(self, inside: str = "") -> None:
        self.inside = inside

    def require(self, path: Path, force: bool, inputs: list[Path]) -> None:
        """Raise `UsageError` for a folder with files without `--force`, or with an input."""
        folder = path / self.inside
        if path.exists() and not path.is_dir():
            raise UsageError("is a file; name a folder")
        for source in inputs:
            if folder.resolve() in source.resolve().parents:
                raise UsageError(
                    f"has {source} in it, an input of this command; name another folder"
                )
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())) and not force:
            inside = f" ({folder})" if self.inside else ""
            raise UsageError(
                f"is not empty{inside}; name a new folder, or replace its files with {FORCE_OPTION}"
            )


class NewFolder(OutputPath):
    """A folder that must not exist, not even with `--force`."""

    def require(self, path: Path, force: bool, inputs: list[Path]) -> None:
        """Raise `UsageError` for anything that exists."""
        if path.exists():
            raise UsageError("exists already; name a new folder")


class SharedFolder(OutputPath):
    """A folder to which files are added, each under a name that no other has."""

    def __call__(self, text: str) -> Any:
        """Return the path; the name of a file is a mistake."""
        path = super().__call__(text)
        if path.suffix == ".mcap" and not path.is_dir():
            raise argparse.ArgumentTypeError(f"{text!r} is named like a file; name a folder for it")
        return path

    def require(self, path: Path, force: bool, inputs: list[Path]) -> None:
        """Raise `UsageError` for a file."""
        if path.exists() and not path.is_dir():
            raise UsageError("is a file; name a folder")


def add_force_option(parser: argparse.ArgumentParser) -> None:
    """Add `--force` to a parser, and those below it, that have outputs."""
    actions = list(parser._actions)
    for action in actions:
        if isinstance(action, argparse._SubParsersAction):
            for subparser in action.choices.values():
                add_force_option(subparser)
    if any(isinstance(action.type, OutputPath) for action in actions):
        parser.add_argument(FORCE_OPTION, action="store_true", help="replace files that exist")


def check_outputs(parser: argparse.ArgumentParser, args: argparse.Namespace) -> None:
    """Check every output that is named in `args` against what exists and what is read.

    Raises `UsageError`, one line with the option, if it must not be overwritten.
    """
    outputs = find_outputs(parser, args)
    if not outputs:
        return
    values = {k: v for k, v in vars(args).items() if k not in {a.dest for a, _ in outputs}}
    inputs = [path for value in values.values() for path in _find_named_files(value)]
    force = bool(getattr(args, "force", False))
    earlier: list[tuple[str, Path]] = []
    for action, path in outputs:
        option = action.option_strings[0]
        try:
            action.type.require(path, force, inputs)  # type: ignore[union-attr]
        except UsageError as error:
            raise UsageError(f"{option} {path}: {error}") from error
        except OSError as error:
            raise UsageError(f"{option} {path}: {error.strerror}") from error
        for other_option, taken_path in earlier:
            if not is_special(path) and path.resolve() == taken_path.resolve():
                raise UsageError(f"{option} {path}: is that of {other_option} too; name another")
        earlier.append((option, path))


def find_outputs(
    parser: argparse.ArgumentParser, args: argparse.Namespace
) -> list[tuple[argparse.Action, Path]]:
    """Return the options that name outputs, and the paths that `args` has for them."""
    outputs = []
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            chosen = action.choices.get(str(getattr(args, action.dest, "")))
            if chosen is not None:
                outputs += find_outputs(chosen, args)
        elif isinstance(action.type, OutputPath):
            path = getattr(args, action.dest, None)
            if isinstance(path, Path):
                outputs.append((action, path))
    return outputs


def parse_output(kind: OutputPath, option: str, text: str) -> Path:
    """Return the path of an output that has a default name; `UsageError` if it cannot be."""
    try:
        return Path(kind(text))
    except argparse.ArgumentTypeError as error:
        raise UsageError(f"{option}: {error}") from error


def make_folder(folder: Path, first: str) -> None:
    """Make the folder of an `--out`, and see that the file `first` can be written there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        OutputFile()(str(folder / first))
    except (FileExistsError, NotADirectoryError) as error:
        raise UsageError(f"--out {folder}: is a file, or in one; name a folder") from error
    except OSError as error:
        raise UsageError(f"--out {folder}: cannot be made: {error.strerror}") from error
    except argparse.ArgumentTypeError as error:
        raise UsageError(f"--out {folder}: {error}") from error


@contextlib.contextmanager
def replace_file(path: Path) -> Iterator[Path]:
    """Yield a path to write to, which takes the place of `path` when all is written.

    A link stays one; after an error, or an interruption, the old file is as it was.
    """
    if is_special(path):
        yield path
        return
    target = path.resolve()
    partial = _build_partial_path(target)
    try:
        yield partial
        partial.replace(target)
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)


@contextlib.contextmanager
def make_new_folder(path: Path) -> Iterator[Path]:
    """Yield a folder to write to, which becomes the new folder `path` when all is written.

    After an error, or an interruption, there is none.
    """
    partial = _build_partial_path(path.absolute())
    try:
        partial.mkdir(parents=True)
        try:
            yield partial
            NewFolder().require(path, False, [])
            partial.rename(path)
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from error


def save_figure(figure: Any, path: Path, **options: Any) -> None:
    """Write a figure of Matplotlib, whole or not at all; the suffix decides the format."""
    with replace_file(path) as partial:
        figure.savefig(partial, format=path.suffix[1:].lower(), **options)


def is_special(path: Path) -> bool:
    """Return whether this is a pipe or a device, which is written to and never replaced."""
    return path.exists() and not path.is_file() and not path.is_dir()


def _build_partial_path(path: Path) -> Path:
    return path.with_name(f".{path.name[:200]}.{os.getpid()}.partial")


def is_same_file(a: Path, b: Path) -> bool:
    """Return whether two paths are one file, links included."""
    try:
        return os.path.samefile(a, b)
    except OSError:
        return False


def _find_named_files(value: Any) -> Iterator[Path]:
    """Yield the existing files that an argument names, as `FILE` or `KEY=FILE`."""
    if isinstance(value, list | tuple):
        for item in value:
            yield from _find_named_files(item)
    elif isinstance(value, str | Path):
        for text in (str(value), str(value).partition("=")[2]):
            path = Path(text)
            with contextlib.suppress(OSError, ValueError):
                if text and path.is_file():
                    yield path
