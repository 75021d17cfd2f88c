"""Run the blocks of a tutorial in order, as a reader would: `python tests/docs/tutorial.py PAGE`.

A block with a title is saved under that name. Blocks of `sh` and `python` are run, one after the
other, in the current folder and by the `teleop`, `python` and `pip` of this environment; all others
(`console`: other machines, screens, what never ends) are only read. A block behind the comment
`<!-- test: also exit code 1 -->` may end with that code, as of a recording on a busy machine.
"""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

_BLOCK = re.compile(
    r'^(<!-- test: also exit code 1 -->\n)?```(\w+)(?: title="([^"]+)")?\n(.*?)^```$', re.M | re.S
)
_PIP = "install --quiet --disable-pip-version-check --no-index --no-deps --no-build-isolation"


class Block(NamedTuple):
    may_fail: str
    language: str
    title: str
    text: str


def read_blocks(page: Path) -> list[Block]:
    return [Block(*parts) for parts in _BLOCK.findall(page.read_text("utf-8"))]


def write_shims(folder: Path) -> dict[str, str]:
    """Return an environment in which the three programs are those of this interpreter.

    They need no installed `teleop`, and `pip` installs into `folder`, without the network.
    """
    programs, site = folder / "bin", folder / "site"
    programs.mkdir()
    for name, words in (
        ("teleop", '-P -m teleop "$@"'),
        ("python", '"$@"'),
        ("pip", f'-m pip {_PIP} --target {site} "${{@:2}}"'),
    ):
        file = programs / name
        file.write_text(f'#!/bin/bash\nexec "{sys.executable}" {words}\n')
        file.chmod(0o755)
    paths = os.pathsep.join(filter(None, (str(site), os.environ.get("PYTHONPATH"))))
    return os.environ | {"PATH": f"{programs}:{os.environ['PATH']}", "PYTHONPATH": paths}


def run_page(page: Path, folder: Path, tools: Path, environment: dict[str, str]) -> int:
    """Run a page in an empty folder; return how many blocks ran. Raises at the first failure.

    Consecutive blocks of `sh` are one script, so that a job in the background goes on.
    """
    ran = 0
    script = ["set -eo pipefail", "trap 'kill $(jobs -p) 2>/dev/null || true' EXIT"]
    for number, block in enumerate(read_blocks(page)):
        if block.title:
            file = folder / block.title
            script.append(f"mkdir -p {file.parent} && cp {tools}/{number} {file}")
            (tools / str(number)).write_text(block.text)
        elif block.language in ("sh", "python"):
            text = block.text
            if block.language == "python":
                (tools / str(number)).write_text(text)
                text = f"python {tools}/{number}"
            if block.may_fail:
                text = f"{text.rstrip()} || [ $? = 1 ]"
            script += [f"echo '== block {number}'", text]
            ran += 1
    subprocess.run(["bash", "-c", "\n".join(script)], cwd=folder, env=environment, check=True)
    return ran


if __name__ == "__main__":
    import tempfile

    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    with tempfile.TemporaryDirectory() as scratch:
        run_page(Path(sys.argv[1]), Path.cwd(), Path(scratch), os.environ | {"PATH": path})
