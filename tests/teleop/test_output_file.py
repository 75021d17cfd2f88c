"""No command overwrites an input, or a file that exists, unless told to."""

import argparse
import os
import stat
from pathlib import Path

import pytest

from teleop.cli import commands
from teleop.errors import UsageError
from teleop.runtime.output_file import (
    NewFolder,
    OutputFile,
    OutputFolder,
    OutputPath,
    SharedFolder,
    UpdatedFile,
    add_force_option,
    check_outputs,
    replace_file,
)

# options that name files to be read: every other option with a path must be an Output
INPUTS = {
    "--calibration", "--columns", "--compare", "--config", "--keys", "--mapping",
    "--replay", "--validate",
}  # fmt: skip
# parts of the name of an option that writes
WRITES = {"out", "save", "json", "figure", "supplement", "package", "record", "report", "dump"}


def parsers():
    """Yield the name of each command of the program and its complete parser."""
    for name in commands.COMMANDS:
        parser = commands.build_parser(name)
        (subcommands,) = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
        yield name, subcommands.choices[name]


def walk(parser):
    """Yield each parser with actions of its own, the given one and those below it."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from walk(below)


def test_every_option_that_names_an_output_is_checked_and_may_be_forced():
    outputs = 0
    for command, top in parsers():
        for parser in walk(top):
            found = [a for a in parser._actions if isinstance(a.type, OutputPath)]
            outputs += len(found)
            forced = any(
                a.dest == "force" and isinstance(a, argparse._StoreTrueAction)
                for a in parser._actions
            )
            assert forced == bool(found), command
            for action in parser._actions:
                option = (action.option_strings or [""])[-1]
                if not option or action in found or option in INPUTS or action.nargs == 0:
                    continue
                assert action.type is not Path, f"{command} {option}: an input or an output?"
                assert not set(option.strip("-").split("-")) & WRITES, f"{command} {option}"
    assert outputs > 25


def parse(words, **types):
    """Parse and check a command line with outputs and the positional `data`."""
    parser = argparse.ArgumentParser()
    parser.add_argument("data", nargs="*")
    parser.add_argument("--model", action="append", default=[])
    for name, kind in types.items():
        parser.add_argument(f"--{name}", type=kind)
    add_force_option(parser)
    args = parser.parse_args([str(word) for word in words])
    check_outputs(parser, args)
    return args


@pytest.fixture
def old(tmp_path):
    path = tmp_path / "old.csv"
    path.write_text("mine")
    return path


def test_an_existing_file_is_refused_unless_forced(old):
    with pytest.raises(UsageError, match=r"--out .*old.csv: exists; .*--force"):
        parse(["--out", old], out=OutputFile())
    assert parse(["--out", old, "--force"], out=OutputFile()).out == old
    assert parse(["--out", old], out=UpdatedFile()).out == old
    assert old.read_text() == "mine"


@pytest.mark.parametrize("how", ["same", "relative", "symlink", "hard link", "key"])
@pytest.mark.parametrize("kind", [OutputFile, UpdatedFile])
def test_an_input_is_never_an_output(old, how, kind, monkeypatch):
    monkeypatch.chdir(old.parent)
    other = old.with_name("link.csv")
    names = {"same": old, "relative": Path("old.csv"), "symlink": other, "hard link": other}
    if how == "symlink":
        other.symlink_to(old)
    elif how == "hard link":
        os.link(old, other)
    words = ["--model", f"1a={old}"] if how == "key" else [old]
    with pytest.raises(UsageError, match=r"is an input of this command too"):
        parse([*words, "--out", names.get(how, old), "--force"], out=kind())


def test_two_outputs_must_not_be_one_file(tmp_path):
    words = ["--out", tmp_path / "a", "--json", tmp_path / "." / "a"]
    with pytest.raises(UsageError, match=r"--json .*: is that of --out too"):
        parse(words, out=OutputFile(), json=OutputFile())


def test_a_folder_is_new_or_empty_unless_forced(tmp_path):
    folder = tmp_path / "report"
    parse(["--out", folder], out=OutputFolder())
    folder.mkdir()
    parse(["--out", folder], out=OutputFolder())
    (folder / "bench.csv").touch()
    with pytest.raises(UsageError, match=r"is not empty; .*--force"):
        parse(["--out", folder], out=OutputFolder())
    parse(["--out", folder, "--force"], out=OutputFolder())
    parse(["--out", tmp_path], out=OutputFolder("mine"))
    with pytest.raises(UsageError, match="is not empty"):
        parse(["--out", tmp_path], out=OutputFolder("report"))
    with pytest.raises(UsageError, match=r"has .*bench.csv in it, an input"):
        parse([folder / "bench.csv", "--out", folder, "--force"], out=OutputFolder())
    with pytest.raises(UsageError, match="exists already"):
        parse(["--out", folder, "--force"], out=NewFolder())
    for kind in (OutputFolder, SharedFolder):
        with pytest.raises(UsageError, match="is a file"):
            parse(["--out", folder / "bench.csv", "--force"], out=kind())


def test_an_impossible_output_is_found_out_at_once(tmp_path):
    (tmp_path / "file").touch()
    for place, why in (
        (tmp_path / "no" / "run.json", "No such file or directory"),
        (tmp_path / "file" / "run.json", "Not a directory"),
        (tmp_path, "is a folder"),
        (Path("/proc/run.json"), "cannot be written"),
        ("a\0b", "cannot be written"),
        ("", "folder|empty"),
    ):
        with pytest.raises(argparse.ArgumentTypeError, match=why):
            OutputFile()(str(place))
    for kind in (OutputFolder, NewFolder, SharedFolder):
        with pytest.raises(argparse.ArgumentTypeError, match="empty"):
            kind()("")


def test_a_format_is_checked_when_the_words_are_read(tmp_path):
    kind = OutputFile(".png", ".svg")
    assert kind(str(tmp_path / "x.PNG")) == tmp_path / "x.PNG"
    for name in ("x.foo", "x", "png", "x.png.txt"):
        with pytest.raises(argparse.ArgumentTypeError, match=r"must end in one of \.png, \.svg"):
            kind(str(tmp_path / name))


def test_looking_at_an_output_leaves_nothing(old):
    for name in ("old.csv", "new.csv"):
        assert OutputFile()(str(old.with_name(name))) == old.with_name(name)
    assert list(old.parent.iterdir()) == [old]
    assert old.read_text() == "mine"


def interrupt_after(_):
    raise KeyboardInterrupt


def test_what_is_interrupted_leaves_the_old_file_and_nothing_else(old):
    link = old.with_name("link.csv")
    link.symlink_to(old)
    with pytest.raises(KeyboardInterrupt), replace_file(link) as partial:
        interrupt_after(partial.write_text("half"))
    assert old.read_text() == "mine"
    with replace_file(link) as partial:
        partial.write_text("whole")
        assert old.read_text() == "mine"
    assert old.read_text() == "whole"
    assert link.is_symlink()
    assert set(old.parent.iterdir()) == {old, link}


def test_a_pipe_is_written_to(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    assert parse(["--out", pipe], out=OutputFile()).out == pipe
    with replace_file(pipe) as place:
        assert place == pipe
    assert stat.S_ISFIFO(pipe.stat().st_mode)


@pytest.mark.parametrize(
    "words",
    [
        ["estimate", "DATA", "--fit", "--save", "DATA"],
        ["estimate", "DATA", "--fit", "--save", "DATA", "--force"],
        ["simulate", "--out", "OTHER"],
        ["diagnose", "DATA", "--json", "OTHER"],
        ["diagnose", "DATA", "--out", "FOLDER"],
        ["calibrate", "--figure", "FOLDER/x.foo"],
        ["view", "--out", "FOLDER/x.csv"],
        ["recordings", "to-ros2", "DATA", "--out", "FOLDER"],
        ["recordings", "to-table", "DATA", "--out", "OTHER"],
        ["recordings", "to-table", "DATA", "--out", "DATA", "--force"],
        ["recordings", "to-lerobot", "DATA", "--out", "FOLDER", "--task", "x", "--force"],
    ],
)
def test_commands_refuse_in_one_line_and_harm_nothing(tmp_path, refused, words):
    for name in ("data.csv", "other.csv"):
        (tmp_path / name).write_text("time_s,proximal_tension_N\n")
    places = {"DATA": "data.csv", "OTHER": "other.csv", "FOLDER": "."}
    named = [
        word.replace(key, str(tmp_path / name))
        for word in words
        for key, name in [next(((k, n) for k, n in places.items() if word.startswith(k)), ("", ""))]
    ]
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    refused(*named)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
