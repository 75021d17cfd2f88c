"""The pages of reports in a real browser: no table is cut, on a screen or on paper."""

import json

import pytest

from estimator.text_table import Table
from studies.testbed import browser
from teleop.cli.html_page import Page

pytestmark = pytest.mark.skipif(browser.program() is None, reason="no Chromium on this machine")

A4 = 718  # [pixels at 96 dpi] of an A4 page, without its margins
PARTS = ("whole record", "fitted part", "validation", "left out", "rival", "reference")
HEAD = ("force at the tip in", "data", *(f"RMSE of the {part}, one model" for part in PARTS), "all")
NUMBERS = (
    *("bench-2026-03-14-long-name-of-a-file_with_underscores.csv", "validation"),
    *("0.1234 +- 0.0056 N", "12.3 %", "-0.000123", "1.23e-05", "n/a", "0.98 (0.91 to 1.04)", "1"),
)
CUT = """
JSON.stringify([...document.querySelectorAll("th, td")].filter((cell) => {
  const box = cell.getBoundingClientRect(), place = cell.closest(".scroll").getBoundingClientRect();
  return box.right > place.right + 1 || cell.scrollWidth > cell.clientWidth + 1
    || box.right > document.documentElement.clientWidth + 1;
}).map((cell) => cell.innerText))
"""
SHORT = "document.querySelectorAll('td')[1].innerHTML"  # a word that need not be broken


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    page = Page("A report")
    page.add_table(Table(HEAD, (NUMBERS,) * 3), mark="")
    page.add_table(
        Table(("cause", "what it explains"), (("creep", "a long text " * 30),)), mark="creep"
    )
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(page.render())
    return path.as_uri()


@pytest.mark.parametrize(("media", "width"), [("print", A4), ("screen", 800)])
def test_every_cell_of_every_table_is_seen_whole(report, media, width):
    with browser.Browser(width, 800) as page:
        page.ask("Emulation.setEmulatedMedia", media=media)
        page.open(report)
        cut = json.loads(page.ask("Runtime.evaluate", expression=CUT)["result"]["value"])
        assert cut == []
        assert "<wbr>" not in page.ask("Runtime.evaluate", expression=SHORT)["result"]["value"]
