"""The `teleop` program: every command resolves, explains itself and complains in one line."""

import importlib
import subprocess
import sys

import pytest

from teleop.app import cli


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_every_command_resolves_and_explains_itself(command, capsys):
    module, _ = cli.COMMANDS[command]
    assert callable(importlib.import_module(module).main)
    with pytest.raises(SystemExit) as end:
        cli.main([command, "--help"])
    assert end.value.code == 0
    assert len(capsys.readouterr().out.splitlines()) > 3


@pytest.mark.parametrize(
    "words",
    [
        [],
        ["fly"],
        ["run", "--fly"],
        ["run", "--config", "no-such.yaml"],
        ["run", "--duration", "soon"],
        ["estimate", "no-such.csv", "--fit"],
    ],
)
def test_wrong_words_get_one_line_and_exit_code_2(words, capsys):
    assert cli.main(words) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith("teleop")
    assert len(captured.err.splitlines()) == 1
    assert captured.out == ""


@pytest.mark.parametrize("command", ["run", "master", "slave", "record", "view"])
@pytest.mark.parametrize("option", ["--duration=-1", "--duration=inf", "--json=/no/where.json"])
def test_every_command_refuses_a_wrong_duration_and_an_impossible_summary(command, option, capsys):
    assert cli.main([command, option]) == 2
    captured = capsys.readouterr()
    assert option.split("=")[0] in captured.err
    assert len(captured.err.splitlines()) == 1
    assert captured.out == ""


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_standard_streams_are_no_defect(closed, tmp_path):
    run = f"{sys.executable} -m teleop run --config no-such.yaml {closed}"
    ended = subprocess.run(run, shell=True, capture_output=True, text=True, check=False)  # noqa: S602
    assert ended.returncode == 2
    assert ended.stderr.startswith("teleop: no-such.yaml") or "2>&-" in closed
    ended = subprocess.run(  # noqa: S602
        f"{sys.executable} -m teleop doctor {closed}", shell=True, capture_output=True, check=False
    )
    assert ended.returncode in (0, 1)
    assert ended.stderr == b""


def test_a_closed_stream_is_replaced_by_one_that_takes_everything(monkeypatch):
    for name in ("stdin", "stdout", "stderr"):
        monkeypatch.setattr(sys, name, None)
    assert cli.main(["run", "--config", "no-such.yaml"]) == 2
    with sys.stdin, sys.stdout, sys.stderr:
        sys.stdout.write("nowhere")
        sys.stderr.write("nowhere")
        assert sys.stdin.read() == ""


INTERRUPTED = """
import os, signal, sys
from teleop import __main__

def interrupt(*_):
    os.kill(os.getpid(), signal.SIGINT)

moment = sys.argv.pop(1)
if moment == "importing":
    class Finder:
        def find_spec(name, *_):
            if name == "teleop.output_file":
                interrupt()
    sys.meta_path.insert(0, Finder)
else:
    import teleop.app.doctor

    def compiled(*_):
        try:
            interrupt()
        except KeyboardInterrupt:
            raise RuntimeError("no compiled object yet") from None

    teleop.app.doctor.main = compiled if moment == "compiling" else interrupt
sys.exit(__main__.main())
"""


@pytest.mark.parametrize("moment", ["importing", "running", "compiling"])
def test_an_interrupted_command_says_so_in_one_line(moment):
    ended = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, moment, "doctor"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "teleop: interrupted\n")


def test_help_needs_no_device_transport_or_viewer_library():
    program = (
        "import sys; from teleop.app import cli\n"
        "try: cli.main(['--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {'zenoh', 'rerun', 'numba', 'hidraw', 'hid', 'scipy'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", program], check=True, capture_output=True)
