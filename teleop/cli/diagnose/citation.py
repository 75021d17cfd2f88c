"""How to cite this software, from CITATION.cff."""

import sysconfig
from importlib.metadata import version
from pathlib import Path
from typing import Any

import yaml

CITATION_FILE = "CITATION.cff"
CITATION_PATHS = (
    Path(__file__).parents[3] / CITATION_FILE,  # of the sources
    Path(sysconfig.get_path("data"))
    / "share"
    / "tendon-teleop"
    / CITATION_FILE,  # of an installed wheel
)


def load_citations() -> tuple[str, ...]:
    """Return the references to be cited: the software, then the papers that it names."""
    path = next((place for place in CITATION_PATHS if place.is_file()), None)
    if path is None:
        return (
            f"tendon-teleop {version('tendon-teleop')} ({CITATION_FILE} is not in this installation)",
        )
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    software = (
        f"{_format_authors(tree)}. {tree['title']} (version {tree['version']}) [software]. "
        f"{tree['license']}."
    )
    return (software, *(_format_reference(one) for one in tree.get("references", ())))


def _format_reference(tree: dict[str, Any]) -> str:
    year = f" ({tree['year']})" if "year" in tree else ""
    return f"{_format_authors(tree)}{year}. {tree['title']}."


def _format_authors(tree: dict[str, Any]) -> str:
    names = [
        author.get("name") or f"{author['family-names']}, {author['given-names']}"
        for author in tree["authors"]
    ]
    return ", ".join(names)
