"""How figures look, and figures as text for pages and notebooks.

Colours are Okabe and Ito's, which any colour vision tells apart.
"""

import html
import io
import re
from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any, NamedTuple

from estimator.report_table import Table

if TYPE_CHECKING:  # matplotlib takes long to load, and not every command draws
    from matplotlib.figure import Figure

_WORD_LENGTH = 12  # [letters] that stay together in a cell

BLACK, BLUE, VERMILION, GREEN, GREY = "black", "#0072B2", "#D55E00", "#009E73", "#888888"

STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 1.4,
    "figure.constrained_layout.use": True,
    "savefig.dpi": 130,
}


class DrawnFigure(NamedTuple):
    """A figure of a report."""

    name: str
    figure: "Figure"
    caption: str


def use_style() -> AbstractContextManager[None]:
    """Return a context in which figures are drawn in this style."""
    from matplotlib import rc_context

    return rc_context(STYLE)


def to_svg(figure: "Figure", *, cut: bool = False) -> str:
    """Return a figure as an SVG element, `cut` to what is drawn; the same text for the same."""
    from matplotlib import rc_context

    text = io.StringIO()
    with rc_context({**STYLE, "svg.hashsalt": "tendon-teleop", "svg.fonttype": "path"}):
        figure.savefig(
            text,
            format="svg",
            metadata={"Date": None, "Creator": None},
            bbox_inches="tight" if cut else None,
        )
    return re.sub(r"^.*?(?=<svg)", "", text.getvalue(), count=1, flags=re.DOTALL).strip()


def format_html_table(table: Table, mark: str = "") -> str:
    """Return a table for a page; rows with a cell `mark` stand out."""
    head = "".join(f"<th>{_format_cell(cell)}</th>" for cell in table.head)
    rows = "".join(
        ('<tr class="ours">' if mark in row else "<tr>")
        + "".join(f"<td>{_format_cell(cell)}</td>" for cell in row)
        + "</tr>"
        for row in table.rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"


def _format_cell(text: str) -> str:
    """Return text for a cell whose long words, such as paths, may be broken; others are not."""
    marked = re.sub(rf"\S{{{_WORD_LENGTH}}}(?=\S)", lambda match: match[0] + "\0", text)
    return html.escape(marked).replace("\0", "<wbr>")


def format_html_figure(figure: "Figure", caption: str) -> str:
    """Return a figure for a page, as inline SVG."""
    words = html.escape(caption)
    return f"<figure>{to_svg(figure)}<figcaption>{words}</figcaption></figure>"


def format_html_report(
    title: str, tables: Sequence[Table], figures: Sequence[tuple["Figure", str]]
) -> str:
    """Return a report for a notebook: a sentence, tables, and figures with their captions."""
    parts = [f"<p><b>{html.escape(title)}</b></p>", *map(format_html_table, tables)]
    parts += [format_html_figure(figure, caption) for figure, caption in figures]
    return "<div>" + "\n".join(parts) + "</div>"
