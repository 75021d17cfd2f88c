"""studies/README.md lists every study, and each says how to run it and how long it takes."""

import ast
import re

import pytest

from tests.root import ROOT

STUDIES = ROOT / "studies"
PARTS = {"faults.faulty_process", "rigs.model", "testbed.bare_zenoh"}  # processes of a study


def find_studies():
    """Return the modules that are run, by name."""
    found = {}
    for path in STUDIES.rglob("*.py"):
        if 'if __name__ == "__main__":' in path.read_text():
            parts = path.relative_to(STUDIES).with_suffix("").parts
            found[".".join(part for part in parts if part != "__main__")] = path
    return {name: path for name, path in found.items() if name not in PARTS}


def test_the_index_lists_every_study_once():
    listed = re.findall(r"^\| `([\w.]+)` \|", (STUDIES / "README.md").read_text(), re.MULTILINE)
    assert sorted(set(listed) - {"brute_force", "testbed"}) == sorted(find_studies())
    assert len(listed) == len(set(listed))


@pytest.mark.parametrize("name", sorted(find_studies()))
def test_a_study_says_how_it_is_run_and_how_long_it_takes(name):
    text = ast.get_docstring(ast.parse(find_studies()[name].read_text())) or ""
    assert f"python -m studies.{name}" in text
    assert re.search(r"\b(seconds|minutes?|hours?|hour|\d+ s)\b", text)
