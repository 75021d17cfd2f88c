"""What `make docs` generates is in the site, and what refers to it finds it."""

import re

import pytest

from estimator.effects import NAMES
from teleop.messages.topics import TOPICS
from tests.root import ROOT

mkdocs_build = pytest.importorskip("mkdocs.commands.build", reason="make docs installs it")
load_config = pytest.importorskip("mkdocs.config").load_config


def test_the_site_has_the_messages_and_the_catalogue(tmp_path):
    mkdocs_build.build(load_config(str(ROOT / "mkdocs.yml"), site_dir=str(tmp_path)))
    messages = (tmp_path / "messages.html").read_text()
    assert all(f"<td><code>{topic.name}</code></td>" in messages for topic in TOPICS)
    catalogue = (tmp_path / "diagnosis.html").read_text()
    assert re.findall(r"<tr>\s*<td><code>(\w+)</code></td>", catalogue)[-len(NAMES) :] == list(
        NAMES
    )
