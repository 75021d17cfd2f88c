"""Self-contained HTML pages with tables and figures."""

import base64
import html
import io
import math
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from estimator.figure_style import format_html_table, use_style
from estimator.report_table import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# --- values as JSON has them: no records, no numpy types, nothing that is not finite


def to_json_values(value: Any) -> Any:
    """Return a value for JSON: a record becomes a dict of its fields, NaN and infinity None.

    Records are named tuples and dataclasses; numpy's arrays become lists, its numbers Python's.
    """
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        value = value._asdict()
    elif is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    elif isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, dict):
        return {str(key): to_json_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_json_values(item) for item in value]
    if isinstance(value, str | bool | int) or value is None:
        return value
    number = float(value)
    return number if math.isfinite(number) else None


STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff;
  max-width: 78rem; margin: 2rem auto; padding: 0 1rem; }
p, ul { max-width: 60rem; }
h1 { line-height: 1.2; } h2 { margin-top: 2.5rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.85rem; font-variant-numeric: tabular-nums; }
th, td { padding: 0.25rem 0.6rem; text-align: left; border-bottom: 1px solid #ddd;
  vertical-align: top; }
th { background: #f4f7fa; }
tr.ours td { background: #eaf3f9; }
.card { border: 1px solid #b7d3e6; border-radius: 0.4rem; padding: 0.2rem 1rem; margin: 1rem 0;
  max-width: 58rem; }
dt { font-weight: 600; } dd { margin: 0 0 0.4rem; }
summary { font-size: 1.1rem; margin: 2rem 0 1rem; cursor: pointer; }
figure { margin: 1.5rem 0; } img, svg { max-width: 100%; height: auto; }
figcaption { font-size: 0.9rem; color: #444; max-width: 48rem; }
@page { margin: 14mm; }
@media print {
  body { font-size: 10pt; max-width: none; margin: 0; padding: 0; }
  .scroll { overflow: visible; }
  table { font-size: 7.5pt; }
  th, td { padding: 0.15rem 0.25rem; }
  th { background: none; }
  tr, figure { break-inside: avoid; }
  h1, h2 { break-after: avoid; }
}
"""


class Page:
    """An HTML page; each method appends to it."""

    def __init__(self, title: str) -> None:
        self._title, self._is_folded = title, False
        self._parts = [f"<h1>{html.escape(title)}</h1>"]

    def add_heading(self, text: str) -> None:
        """Add a heading."""
        self._parts.append(f"<h2>{html.escape(text)}</h2>")

    def add_text(self, text: str) -> None:
        """Add a paragraph."""
        self._parts.append(f"<p>{html.escape(text)}</p>")

    def add_points(self, items: Sequence[str]) -> None:
        """Add a list."""
        inner = "".join(f"<li>{html.escape(item)}</li>" for item in items)
        self._parts.append(f"<ul>{inner}</ul>")

    def add_table(self, table: Table, mark: str = "") -> None:
        """Add a table; rows with a cell `mark` stand out."""
        self._parts.append(f'<div class="scroll">{format_html_table(table, mark)}</div>')

    def add_section(self, title: str, table: Table, text: str = "", mark: str = "") -> None:
        """Add a table with a heading and, if there is one, a paragraph before it."""
        self.add_heading(title)
        if text:
            self.add_text(text)
        self.add_table(table, mark)

    def add_figure(self, figure: "Figure", caption: str) -> None:
        """Add a figure of Matplotlib as an image."""
        image = io.BytesIO()
        with use_style():
            figure.savefig(image, format="png")
        self.add_image(image.getvalue(), caption)

    def add_image(self, png: bytes, caption: str) -> None:
        """Add the bytes of a PNG file."""
        data, words = base64.b64encode(png).decode(), html.escape(caption)
        self._parts.append(
            f'<figure><img src="data:image/png;base64,{data}" alt="{words}">'
            f"<figcaption>{words}</figcaption></figure>"
        )

    def add_drawing(self, svg: str, caption: str) -> None:
        """Add an SVG element."""
        words = html.escape(caption)
        self._parts.append(f"<figure>{svg}<figcaption>{words}</figcaption></figure>")

    def add_card(self, title: str, rows: Sequence[tuple[str, str]]) -> None:
        """Add a box with a title and named texts."""
        inner = "".join(
            f"<dt>{html.escape(name)}</dt><dd>{html.escape(text)}</dd>" for name, text in rows
        )
        self._parts.append(f'<div class="card"><h3>{html.escape(title)}</h3><dl>{inner}</dl></div>')

    def fold(self, title: str) -> None:
        """Begin what is hidden until it is opened; it ends with the next one, or the page."""
        end = "</details>" if self._is_folded else ""
        self._parts.append(f"{end}<details><summary>{html.escape(title)}</summary>")
        self._is_folded = True

    def render(self) -> str:
        """Return the page."""
        closing = "</details>" if self._is_folded else ""
        return (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{html.escape(self._title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
            + "\n".join(self._parts)
            + f"{closing}\n</body>\n</html>\n"
        )
