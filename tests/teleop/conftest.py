"""Commands that are refused."""

import re

import pytest

from teleop.cli import commands


@pytest.fixture
def refused(capsys):
    """Run a command line that must be refused; return the one line that says why."""

    def run(*words):
        capsys.readouterr()
        assert commands.main([str(word) for word in words]) == 2
        said = capsys.readouterr()
        progress = r"^(?!teleop).* \.\.\.\n"
        (line,) = re.sub(progress, "", said.err, flags=re.MULTILINE).splitlines()
        assert line.startswith("teleop")
        assert said.out == ""
        return line

    return run
