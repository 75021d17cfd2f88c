"""Results of a diagnosis or a study of a pair as text, as a figure and as a page of a notebook."""

from typing import NamedTuple

from matplotlib.figure import Figure

from estimator.diagnosis import figures as diagnosis_figures
from estimator.diagnosis import report_text as diagnosis_text
from estimator.diagnosis.outcome import Diagnosis
from estimator.figure_style import format_html_report, use_style
from estimator.pair import figures as pair_figures
from estimator.pair import report_text as pair_text
from estimator.pair.pair_study import PairStudy


class HtmlReport(NamedTuple):
    """A result that a notebook displays."""

    html: str  # with inline figures

    def _repr_html_(self) -> str:
        return self.html


def summarise_result(result: Diagnosis | PairStudy) -> str:
    """Return a result in one sentence, its tables and what follows from it, as Markdown text."""
    if isinstance(result, PairStudy):
        return pair_text.format_report(result)
    return diagnosis_text.format_summary(result)


def plot_result(result: Diagnosis | PairStudy, record: int = 0) -> Figure:
    """Return the main figure of a result.

    Of a diagnosis one fitted record, by its number from 0: measured, simulated, and residuals. Of a
    pair the measured and the predicted angle over the command, of all records.
    """
    with use_style():
        if isinstance(result, PairStudy):
            return pair_figures.draw_loops(result)
        return diagnosis_figures.draw_over_time(result, record)


def show_result(result: Diagnosis | PairStudy) -> HtmlReport:
    """Return a result with its tables and all figures, for the end of a notebook's cell."""
    if isinstance(result, PairStudy):
        pair_drawn = [(item.figure, item.caption) for item in pair_figures.draw_figures(result)]
        return HtmlReport(
            format_html_report(
                pair_text.format_sentence(result), pair_text.build_report_tables(result), pair_drawn
            )
        )
    drawn = [(item.figure, item.caption) for item in diagnosis_figures.draw_figures(result)]
    return HtmlReport(
        format_html_report(
            diagnosis_text.format_verdict(result), diagnosis_text.build_tables(result), drawn
        )
    )
