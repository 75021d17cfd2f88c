"""Each tutorial runs in an empty folder, and what README and a page show of sessions in Python."""

import re
import subprocess
import sys

import pytest

from teleop import Session
from tests.docs.tutorial import run_page, write_shims
from tests.root import ROOT

PAGES = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
(SESSION,) = re.findall(r"^SESSION='(.*?)'", (ROOT / ".ci" / "run").read_text(), re.M)


def marks(page):
    """All are slow: .ci/run runs each from the wheel, those with sessions after the tests."""
    has_sessions = re.search(SESSION, page.read_text(), re.M)
    return [pytest.mark.slow, pytest.mark.real_time] if has_sessions else [pytest.mark.slow]


@pytest.fixture
def folders(tmp_path):
    """Return an empty folder for a page, and one for what runs it."""
    places = tmp_path / "work", tmp_path / "tools"
    for place in places:
        place.mkdir()
    return places


@pytest.mark.parametrize("page", [pytest.param(p, id=p.stem, marks=marks(p)) for p in PAGES])
def test_a_tutorial_runs_in_order(page, folders):
    assert run_page(page, *folders, write_shims(folders[1])) >= 2


@pytest.mark.slow  # .ci/run does, after the tests
@pytest.mark.real_time
@pytest.mark.parametrize("page", ["README.md", "docs/reference/api.md"])
def test_the_sessions_of_a_page_run_as_they_are(page, tmp_path):
    (tmp_path / "configs").symlink_to(ROOT / "configs")

    def run(block):
        ended = subprocess.run(
            [sys.executable, "-c", block], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert ended.returncode == 0, block + ended.stderr
        assert ended.stdout or "print" not in block

    blocks = re.findall(r"^```python\n(.*?)^```", (ROOT / page).read_text(), re.M | re.S)
    assert len(blocks) > 1
    for block in blocks:
        if "join_session" in block:
            with Session(ROOT / "configs" / "demo.yaml") as session:  # others may run beside it
                run(block.replace("join_session()", f'join_session("{session.name}")'))
        elif "from teleop import" in block:
            run(block)


def test_a_block_that_fails_is_noticed(folders, tmp_path):
    folder, tools = folders
    environment = write_shims(tools)
    page = tmp_path / "page.md"
    page.write_text('```yaml title="a/b.txt"\nhere\n```\n```sh\ngrep here a/b.txt\n```\n')
    assert run_page(page, folder, tools, environment) == 1
    page.write_text("```sh\nfalse\n```\n```sh\ntouch after\n```\n")
    with pytest.raises(subprocess.CalledProcessError, match="exit status"):
        run_page(page, folder, tools, environment)
    assert not (folder / "after").exists()
