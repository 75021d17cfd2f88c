"""How to cite this software, from CITATION.cff."""

import sysconfig
from importlib.metadata import version
from pathlib import Path
from typing import Any

import yaml

NAME = "CITATION.cff"
PLACES = (
    Path(__file__).parents[3] / NAME,  # of the sources
    Path(sysconfig.get_path("data")) / "share" / "tendon-teleop" / NAME,  # of an installed wheel
)


def citations() -> tuple[str, ...]:
    """Return the references to be cited: the software, then the papers that it names."""
    path = next((place for place in PLACES if place.is_file()), None)
    if path is None:
        return (f"tendon-teleop {version('tendon-teleop')} ({NAME} is not in this installation)",)
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    software = (
        f"{_authors(tree)}. {tree['title']} (version {tree['version']}) [software]. "
        f"{tree['license']}."
    )
    return (software, *(_reference(one) for one in tree.get("references", ())))


def _reference(tree: dict[str, Any]) -> str:
    year = f" ({tree['year']})" if "year" in tree else ""
    return f"{_authors(tree)}{year}. {tree['title']}."


def _authors(tree: dict[str, Any]) -> str:
    names = [
        author.get("name") or f"{author['family-names']}, {author['given-names']}"
        for author in tree["authors"]
    ]
    return ", ".join(names)
