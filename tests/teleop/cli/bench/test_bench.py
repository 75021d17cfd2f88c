"""`teleop bench`: every benchmark resolves and explains itself; a wrong name is one line."""

import importlib
import subprocess
import sys

import pytest

from teleop.cli import commands
from teleop.cli.bench import command


@pytest.mark.parametrize("name", command.BENCHES)
def test_every_benchmark_resolves_and_explains_itself(name, capsys):
    module, summary = command.BENCHES[name]
    assert callable(importlib.import_module(module).main)
    with pytest.raises(SystemExit) as end:
        commands.main(["bench", name, "--help"])
    assert end.value.code == 0
    assert f"usage: teleop bench {name}" in capsys.readouterr().out
    with pytest.raises(SystemExit):
        commands.main(["bench", "--help"])
    assert summary in capsys.readouterr().out


@pytest.mark.parametrize("words", [[], ["fly"], ["loop", "--fly"]])
def test_wrong_words_get_one_line(words, capsys):
    assert commands.main(["bench", *words]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_benchmark_is_imported_only_when_it_runs():
    program = (
        "import sys; from teleop.cli import commands\n"
        "try: commands.main(['bench', '--help'])\n"
        "except SystemExit: pass\n"
        "assert not any(name.startswith('slave') for name in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program], check=True, capture_output=True)
