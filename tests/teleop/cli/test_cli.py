"""The `teleop` program: every command resolves, explains itself and complains in one line."""

import errno
import importlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from teleop.cli import commands


@pytest.mark.parametrize("command", commands.COMMANDS)
def test_every_command_resolves_and_explains_itself(command, capsys):
    module, _ = commands.COMMANDS[command]
    assert callable(importlib.import_module(module).main)
    with pytest.raises(SystemExit) as end:
        commands.main([command, "--help"])
    assert end.value.code == 0
    assert len(capsys.readouterr().out.splitlines()) > 3


def test_control_characters_of_words_stay_in_a_line(capsys):
    assert commands.main(["stop", "--session=a\x1b[2J\nb"]) == 2
    captured = capsys.readouterr().err
    assert captured.endswith("\n")
    assert captured[:-1].isprintable()


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        ("rnu", "did you mean 'run'?"),
        ("keys shwo", "did you mean 'show'?"),
        ("run configs/demo.yaml", "did you mean --config configs/demo.yaml?"),
        ("run --view none --set rate_hz 500", "did you mean --set rate_hz=500?"),
        ("run --durration 3", "did you mean '--duration'?"),
        ("bench loop --secnds 3", "see `teleop bench loop --help`"),
        ("", ""),
        ("fly", ""),
        ("run --config no-such.yaml", "no-such.yaml"),
        ("estimate no-such.csv --fit", "no-such.csv"),
    ],
)
def test_wrong_words_get_one_line_with_a_hint(words, hint, refused):
    assert hint in refused(*words.split())


@pytest.mark.parametrize("command", ["run", "master", "slave", "record", "view"])
@pytest.mark.parametrize("option", ["--duration=inf", "--json=/no/where.json"])
def test_every_command_refuses_a_wrong_duration_and_an_impossible_summary(command, option, refused):
    assert option.split("=")[0] in refused(command, option)


@pytest.mark.parametrize("closed", [">&-", "<&- >&- 2>&-"])
def test_closed_standard_streams_are_no_defect(closed, tmp_path):
    run = f"{sys.executable} -m teleop keys show no-such {closed}"
    ended = subprocess.run(run, shell=True, capture_output=True, text=True, check=False)  # noqa: S602
    assert ended.returncode == 2
    assert ended.stderr.startswith("teleop: no-such") or "2>&-" in closed


INTERRUPTED = """
import os, signal, sys
from teleop import __main__

moment, number = sys.argv.pop(1), int(sys.argv.pop(1))

def interrupt(*_):
    try:
        os.kill(os.getpid(), number)
    finally:
        if moment == "running":
            print("closed")

if moment == "importing":
    class Finder:
        def find_spec(name, *_):
            if name == "teleop.runtime.output_file":
                interrupt()
    sys.meta_path.insert(0, Finder)
else:
    import teleop.cli.doctor

    def compiled(*_):
        try:
            interrupt()
        except KeyboardInterrupt:
            raise RuntimeError("no compiled object yet") from None

    teleop.cli.doctor.main = compiled if moment == "compiling" else interrupt
sys.exit(__main__.main())
"""


@pytest.mark.parametrize(
    ("moment", "number"),
    [("importing", signal.SIGINT), ("compiling", signal.SIGINT), ("running", signal.SIGTERM)],
)
def test_an_interrupted_command_says_so_in_one_line(moment, number):
    ended = run_program(INTERRUPTED, moment, str(int(number)), "doctor")
    closed = "closed\n" if moment == "running" else ""
    wanted = 128 + number, closed, "teleop: interrupted\n"
    assert (ended.returncode, ended.stdout, ended.stderr) == wanted


def run_program(text, *words, **options):
    """Run Python text in a process; returns what it printed, and its exit code."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    return subprocess.run(
        [sys.executable, "-c", text, *words],
        check=False,
        text=True,
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "env": environment} | options,
    )


SAYING = """
import sys
import teleop.cli.doctor
from teleop import __main__

said = sys.argv.pop()

def work(_):
    print(said)
    {}
    return 0

teleop.cli.doctor.main = work
sys.exit(__main__.main())
"""


def fail_with(error):
    raise error


@pytest.mark.parametrize(
    ("work", "line"),
    [
        (lambda: Path("/no/where").read_text(), "/no/where: No such file or directory"),
        (lambda: fail_with(OSError(errno.EMFILE, "Too many")), "Too many; raise"),
        (lambda: fail_with(OSError(errno.EROFS, "Read-only", "a.csv")), "a.csv: Read-only; w"),
        (lambda: fail_with(OSError(errno.ENOSPC, "No space left")), "No space left; free some"),
        (lambda: fail_with(FileNotFoundError(errno.ENOENT, "No usable temporary directory")),
         "No usable temporary directory: set TMPDIR to a folder"),
        (lambda: fail_with(MemoryError()), "not enough memory: close other programs"),
        (lambda: np.empty(1 << 58), "not enough memory (Unable to allocate"),
        (lambda: fail_with(EOFError()), "the input ended before a question was answered"),
    ],
)  # fmt: skip
def test_what_the_system_refuses_is_one_line(work, line, monkeypatch, capsys):
    monkeypatch.setattr("teleop.cli.doctor.main", lambda _: work())
    assert commands.main(["doctor"]) == 1
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith(f"teleop: {line}")


def test_a_defect_of_ours_shows_its_traceback():
    ended = run_program(SAYING.format("raise LookupError('a defect')"), "doctor", "begun")
    assert ended.returncode == 1
    assert "Traceback" in ended.stderr
    assert "LookupError: a defect" in ended.stderr


@pytest.mark.parametrize("work", ["pass", "print('more', flush=True)"])
def test_a_full_output_is_one_line(work):
    with open("/dev/full", "w") as full:
        ended = run_program(SAYING.format(work), "doctor", "begun", stdout=full)
    assert ended.returncode == 1
    assert ended.stderr == "teleop: standard output: No space left on device\n"


@pytest.mark.parametrize("environment", [{}, {"PYTHONUNBUFFERED": "1"}])
def test_a_reader_of_the_output_that_left_is_no_fault(environment):
    end, start = os.pipe()
    os.close(end)
    ended = run_program(
        SAYING.format("pass"), "doctor", "begun", stdout=start, env=os.environ | environment
    )
    os.close(start)
    assert (ended.returncode, ended.stderr) == (0, "")


def test_an_output_without_the_characters_gets_replacements():
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    ended = run_program(SAYING.format("pass"), "doctor", "0.3 ± 0.1", env=environment)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "0.3 ? 0.1\n", "")


@pytest.mark.parametrize("words", [["keys", "init", ""], ["run", "--config", ""]])
def test_no_path_is_empty(words, tmp_path, monkeypatch, refused):
    monkeypatch.chdir(tmp_path)
    assert "the name is empty" in refused(*words)
    assert not list(tmp_path.iterdir())
