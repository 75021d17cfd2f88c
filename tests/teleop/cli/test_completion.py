"""Completion, by the shells themselves: Tab is pressed in a terminal, and the line is read."""

import os
import pty
import re
import select
import shutil
import signal
import time

import pytest

from teleop.cli import completion
from tests.root import ROOT

pytest.importorskip("shtab", reason="make test installs it")

START = {"bash": "bash --norc --noprofile -i", "zsh": "zsh -f -i", "fish": "fish --no-config -i"}
LOAD = {  # as a user would, and a prompt that ends what is read
    "bash": "source {script}; PS1='rea''dy> '",
    "zsh": "autoload -Uz compinit; fpath+={script.parent}; compinit -u -D; PS1='rea''dy> '",
    "fish": "source {script}; function fish_prompt; printf 'rea''dy> '; end",
}
LINES = (  # what is typed before Tab, and what the line is then
    ("teleop dia", "teleop diagnose"),
    ("teleop keys iss", "teleop keys issue"),
    ("teleop run --vi", "teleop run --view"),
    ("teleop config reference --format m", "teleop config reference --format md"),
    ("teleop keys issue --role sup", "teleop keys issue --role supervisor"),
    ("teleop run --set slave.gate.yie", "teleop run --set slave.gate.yield_gain="),
    ("teleop run --config pyproj", "teleop run --config pyproject.toml"),
)
PATIENCE_S = 20.0
_ESCAPES = re.compile(r"\x1b(\[[0-9;?>=]*[A-Za-z]|\][^\x07]*\x07|[()=>][0-9A-B]?)|\r|\x07|\x08")


class Terminal:
    """A shell in a terminal."""

    def __init__(self, command):
        environment = {"PATH": os.environ["PATH"], "HOME": "/nonexistent", "TERM": "xterm"}
        environment |= {k: os.environ[k] for k in ("LD_LIBRARY_PATH", "FPATH") if k in os.environ}
        self.pid, self.stream = pty.fork()
        if self.pid == 0:
            os.chdir(ROOT)
            os.execvpe(command.split()[0], command.split(), environment)  # noqa: S606
        self.text = ""

    def type(self, text):
        self.text = ""
        os.write(self.stream, text.encode())

    def wait_for(self, wanted):
        """Wait for a text on the terminal, without what positions the cursor."""
        limit = time.monotonic() + PATIENCE_S
        while wanted not in _ESCAPES.sub("", self.text):
            assert time.monotonic() < limit, f"no {wanted!r} in {self.text!r}"
            if select.select([self.stream], [], [], 0.1)[0]:
                self.text += os.read(self.stream, 65536).decode(errors="replace")

    def close(self):
        os.kill(self.pid, signal.SIGKILL)
        os.waitpid(self.pid, 0)
        os.close(self.stream)


@pytest.mark.parametrize("shell", completion.SHELLS)
def test_tab_completes_commands_options_choices_keys_and_files(shell, tmp_path):
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    script = tmp_path / "_teleop"  # the name that zsh looks for
    script.write_text(completion.build_script(shell))
    terminal = Terminal(START[shell])
    try:
        terminal.type(LOAD[shell].format(script=script) + "\n")
        terminal.wait_for("ready> ")
        for typed, completed in LINES:
            terminal.type(f"{typed}\t")
            terminal.wait_for(completed)
            terminal.type("\x15\n")  # the line is deleted
            terminal.wait_for("ready> ")
    finally:
        terminal.close()
