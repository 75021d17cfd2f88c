"""The `teleop` program: every command resolves, explains itself and complains in one line."""

import importlib
import subprocess
import sys

import pytest

from teleop import cli


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


def test_help_needs_no_device_transport_or_viewer_library():
    program = (
        "import sys; from teleop import cli\n"
        "try: cli.main(['--help'])\n"
        "except SystemExit: pass\n"
        "heavy = {'zenoh', 'rerun', 'numba', 'hidraw', 'hid', 'scipy'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", program], check=True, capture_output=True)
