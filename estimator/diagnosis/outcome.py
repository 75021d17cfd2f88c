"""What a diagnosis says."""

from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple

from estimator.diagnosis.baseline import Choice
from estimator.diagnosis.bench_scale import UNIT_SCALE, BenchScale
from estimator.diagnosis.dataset import Dataset, Fit
from estimator.diagnosis.force import FileForce, RivalForce
from estimator.diagnosis.prediction import ErrorStatistics, PredictedRecord
from estimator.diagnosis.score import ResidualDependence
from estimator.diagnosis.simple_models import SimpleFit, SimpleGain
from estimator.diagnosis.troubles import DataIssue
from estimator.effects.effect import Effect, Values
from estimator.units import Units

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Verdict(StrEnum):
    """How a diagnosis ends."""

    CLEAN = "clean"  # nothing wrong beyond noise
    NAMED = "named"  # one cause, or one after another
    AMBIGUOUS = "ambiguous"  # one of several that these channels cannot tell apart
    UNEXPLAINED = "unexplained"  # the model is wrong, and nothing in the catalogue explains it


class FittedValue(NamedTuple):
    """A fitted value with its 95 % interval."""

    value: float
    low: float
    high: float
    unit: str
    at_bound: bool = False  # the value is as far as the parameter may go: it may be further


class ModelErrors(NamedTuple):
    """The same on what was fitted and on what was held out, by channel."""

    fit: dict[str, ErrorStatistics]
    held_out: dict[str, ErrorStatistics]
    validation: dict[str, ErrorStatistics]  # empty without records of its own


class RankedCandidate(NamedTuple):
    """A candidate, as it came out."""

    effect: Effect  # the best of its variants
    score: float  # ln of how much more probable held-out data are with it than without
    rmse: dict[str, float]  # held out, by channel
    left: float  # share of what noise does not explain that it leaves
    values: Values  # of its parameters

    @property
    def name(self) -> str:
        """Return the effect's name."""
        return self.effect.name

    @property
    def label(self) -> str:
        """Return the effect's name and variant."""
        return self.effect.label


class CauseStep(NamedTuple):
    """One cause found on top of those before it."""

    effect: Effect
    rivals: tuple[str, ...]  # names that these channels do not tell from it
    ranking: tuple[RankedCandidate, ...]
    fit: Fit  # all causes so far, fitted to all samples


class Gain(NamedTuple):
    """By which share the held-out RMSE of a channel fell, with its 95 % interval."""

    value: float
    low: float
    high: float


class Rival(NamedTuple):
    """A model with another effect in the place of a cause, fitted to all samples."""

    replaces: str  # name of that cause
    effect: Effect
    fit: Fit


class DetectionLimit(NamedTuple):
    """The smallest size at which an effect would have been seen."""

    parameter: str
    size: float
    unit: str


class Diagnosis(NamedTuple):
    """What is wrong with the model of a dataset, why, and the gain of correcting it.

    All numbers are in the units of the records.
    """

    verdict: Verdict
    steps: tuple[CauseStep, ...]
    ranking: tuple[RankedCandidate, ...]  # of the first search
    parameters: dict[str, FittedValue]
    dataset: Dataset
    baseline: Fit  # the plain law, fitted to all samples
    extended: Fit  # the baseline again where nothing was found
    before: ModelErrors
    after: ModelErrors
    gain: dict[str, Gain]
    noise: dict[str, float]
    left: float  # unexplained share: of the error beyond noise, what the extended model leaves
    wanders: bool  # friction changes with time, and not as the causes say
    laws: Choice  # of the base law
    loads: Choice  # of what the tips of several files pull at
    simple_models: tuple[SimpleFit, ...]  # that know no sheath, fitted to the same data
    simple_gain: dict[str, SimpleGain]  # of the extended law over the best of them, by channel
    structure: tuple[ResidualDependence, ...]  # of what the extended model leaves
    detection_limits: dict[str, DetectionLimit]  # by effect; of a clean dataset
    experiments: tuple[str, ...]  # that would settle what is ambiguous
    troubles: tuple[DataIssue, ...]
    fit_all: bool = False  # no sample was held out: all errors are of fitted samples
    rivals: tuple[Rival, ...] = ()  # models with one of the equally good causes
    validation: tuple[PredictedRecord, ...] = ()  # records that were not fitted
    left_out: tuple[PredictedRecord, ...] = ()  # each record, by the fit of the others
    forces: tuple[FileForce, ...] = ()  # error of the force that the loop would estimate
    rival_forces: tuple[RivalForce, ...] = ()  # what each rival would do to that force
    scale: BenchScale = UNIT_SCALE  # of the bench, at which it was made

    @property
    def units(self) -> Units:
        """Units of the records."""
        return self.dataset.records[0].units

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the effects, in the order found."""
        return tuple(step.effect.name for step in self.steps)

    @property
    def duration(self) -> float:
        """Of the longest record [s]."""
        return max(float(record.time[-1]) for record in self.dataset.records)

    @property
    def ambiguous_with(self) -> tuple[str, ...]:
        """Names that cannot be told from one of the causes."""
        names = [name for step in self.steps for name in step.rivals]
        return tuple(dict.fromkeys(name for name in names if name not in self.causes))

    def summary(self) -> str:
        """Return the verdict, tables and next steps as Markdown text."""
        from estimator.diagnosis import report_text  # which imports this module

        return report_text.format_summary(self)

    def plot(self, record: int = 0) -> "Figure":
        """Return a figure of one fitted record: measured, simulated, and residuals."""
        from estimator.diagnosis import figures  # which imports this module
        from estimator.drawing import use_style

        with use_style():
            return figures.draw_over_time(self, record)

    def _repr_html_(self) -> str:
        """Return the verdict, tables and figures for a notebook."""
        from estimator.diagnosis import figures, report_text  # which import this module
        from estimator.drawing import format_html_report

        figures_with_captions = [
            (drawn_figure.figure, drawn_figure.caption)
            for drawn_figure in figures.draw_figures(self)
        ]
        return format_html_report(
            report_text.format_verdict(self), report_text.build_tables(self), figures_with_captions
        )
