"""What `make docs` generates: pages of messages and config keys, the catalogue in diagnosis.md.

A hook of mkdocs (`hooks` in mkdocs.yml); nothing is written beside the site.
"""

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

from teleop.cli.config.reference import render_config_reference
from teleop.cli.diagnose.catalogue import format_catalogue
from teleop.messages.page import format_page

CATALOGUE_MARK = "<!-- catalogue of effects -->"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages of topics and messages, and of the keys of a config."""
    files.append(File.generated(config, "messages.md", content=format_page()))
    keys = render_config_reference()
    files.append(File.generated(config, "reference/configuration-keys.md", content=keys))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Put the catalogue of effects in the place of its mark."""
    return markdown.replace(CATALOGUE_MARK, format_catalogue())
