"""The site: what `make docs` generates is in it, and what refers to a page finds it."""

import re
import subprocess
import time
from functools import cache
from typing import get_args, get_type_hints

import pytest

from estimator.effects import NAMES
from slave.simulation.effects import EffectConfig
from studies.testbed.browser import Browser, find_program
from teleop.cli.commands import COMMANDS
from tests.root import ROOT

DOCS = ROOT / "docs"
GENERATED = {"reference/messages.md", "reference/cli.md"}
FOREIGN = {"docs/design.md", "docs/en/wheel_programming.md"}  # of rmw_zenoh and FFBeast


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Return the folder of the built site."""
    build = pytest.importorskip("mkdocs.commands.build", reason="make docs installs it")
    pytest.importorskip("material", reason="make docs installs it")
    from mkdocs.config import load_config

    folder = tmp_path_factory.mktemp("site")
    build.build(load_config(str(ROOT / "mkdocs.yml"), site_dir=str(folder)))
    return folder


def test_pages_and_tables_are_generated_whole():
    generated = pytest.importorskip("docs.generated", reason="make docs installs mkdocs")
    commands = generated.format_commands()
    assert all(f"\n## teleop {name}\n" in commands for name in COMMANDS)
    effects = [get_args(get_type_hints(c)["type"])[0] for c in get_args(EffectConfig)]
    for page, names in (("diagnose", NAMES), ("rigs", effects)):
        text = (DOCS / "how-to" / f"{page}.md").read_text("utf-8")
        table = generated.on_page_markdown(text)
        assert all(table.count(f"| `{name}`") > text.count(f"| `{name}`") for name in names)


@pytest.mark.slow
def test_no_page_names_a_script_style_or_picture_elsewhere(site):
    loads = r'<(?:script|img|iframe|link rel="(?:stylesheet|icon)")[^>]*?(?:src|href)="(?:\w+:)?//'
    assert not [page for page in site.rglob("*.html") if re.search(loads, page.read_text())]


@pytest.mark.slow
@pytest.mark.skipif(find_program() is None, reason="no Chromium here")
def test_pages_opened_as_files_fit_and_are_searched(site):
    with Browser(1280, 900, "dark") as browser:

        def evaluate(expression):
            answer = browser.ask("Runtime.evaluate", expression=expression, returnByValue=True)
            return answer["result"].get("value")

        for page in sorted(site.rglob("*.html")):
            browser.open(page.as_uri())
            assert evaluate("document.documentElement.scrollWidth") <= 1280, page
            wide = "e => e.scrollWidth > e.clientWidth"
            tables = "[...document.querySelectorAll('.md-typeset__scrollwrap')]"
            assert page.stem == "api" or not evaluate(f"{tables}.some({wide})"), page
        browser.open((site / "index.html").as_uri())
        evaluate("document.querySelector('input[name=query]').focus()")
        browser.ask("Input.insertText", text="latency timer")
        end = time.monotonic() + 60.0
        while not evaluate("document.querySelectorAll('.md-search-result__item').length"):
            assert time.monotonic() < end, "nothing is found"
            time.sleep(0.2)
        assert all(a.startswith(("file:", "data:")) for a in browser.answered)
        assert not browser.complaints


def tracked(*patterns):
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", *patterns],
        cwd=ROOT, capture_output=True, text=True, check=True,
    )  # fmt: skip
    return [ROOT / name for name in listed.stdout.splitlines() if (ROOT / name).is_file()]


def test_every_page_that_the_repository_names_is_there():
    wrong = []
    for file in tracked("*.py", "*.md", "*.yaml", "*.yml", "*.h", "*.ino", "*.toml", "Makefile"):
        for name in re.findall(r"docs/[\w/.-]+\.(?:md|svg|png|gif)\b", file.read_text("utf-8")):
            generated = name.removeprefix("docs/") in GENERATED
            if not ((ROOT / name).exists() or generated or name in FOREIGN):
                wrong.append(f"{file.relative_to(ROOT)}: {name}")
    assert not wrong


@pytest.mark.parametrize(
    "page",
    [p for p in tracked("*.md") if DOCS not in p.parents],
    ids=lambda p: p.relative_to(ROOT).as_posix(),
)
def test_links_outside_the_site_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)\s#]+)[^)]*\)", page.read_text("utf-8")):
        if not re.match(r"\w+:", target):
            assert (page.parent / target).exists(), target


@cache
def texts():
    """Return the program's sources, strings that follow each other joined."""
    files = tracked("teleop/*.py", "master/*.py", "slave/*.py", "estimator/*.py")
    return re.sub(r'"\s+f?"', "", "\n".join(file.read_text("utf-8") for file in files))


def messages():
    """Return the messages in the first columns of troubleshooting, and their fixed words."""
    page = (DOCS / "how-to" / "troubleshooting.md").read_text("utf-8")
    for row in re.findall(r"^\| (.*?) \|", page, re.M):
        for message in re.findall(r"`([^`]+)`", row):
            pieces = re.split(r"\.\.\.|'[^']*'|/dev/\S+|\b[A-Z]\b|[\d.]+|[:;,()]", message)
            yield pytest.param([piece.split() for piece in pieces], id=message[:40])


@pytest.mark.parametrize("pieces", list(messages()))
def test_the_messages_of_troubleshooting_are_the_programs(pieces):
    """Three words of each, or as many as there are between what varies, are in its texts."""
    longest = min(3, max(map(len, pieces)))
    runs = (
        " ".join(words[k : k + longest])
        for words in pieces
        for k in range(len(words) - longest + 1)
    )
    assert any(run in texts() for run in runs), pieces
