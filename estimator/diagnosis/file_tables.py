"""Tables of a diagnosis by file: validation, leave-one-file-out, the force, and its rivals."""

from collections.abc import Sequence

from estimator.diagnosis.force import FileForce
from estimator.diagnosis.outcome import Diagnosis
from estimator.diagnosis.prediction import PredictedRecord
from estimator.text_table import Table
from estimator.units import Units, format_quantity


def name_records(diagnosis: Diagnosis, files: Sequence[str], further: Sequence[str]) -> list[str]:
    """Return what all records are called, the fitted ones first; numbered where not given."""
    fitted_names = list(files) or [f"record {k + 1}" for k in range(len(diagnosis.dataset.records))]
    validation_names = list(further) or [
        f"validation {k + 1}" for k in range(len(diagnosis.validation))
    ]
    return fitted_names + validation_names


def build_prediction_table(records: Sequence[PredictedRecord], names: Sequence[str]) -> Table:
    """Return the errors of both models in records that were not fitted, by file and channel."""
    rows = []
    for name, prediction in zip(names, records, strict=True):
        before, after = prediction.fitness(prediction.before), prediction.fitness(prediction.after)
        start, units = prediction.record.start, prediction.record.units
        times = f"{start:.6g} to {start + float(prediction.record.time[-1]):.6g} s"
        rows += [
            (
                name,
                times,
                units.word(channel),
                str(int(prediction.record.good[channel].sum())),
                str(prediction.spikes[channel]),
                _format_error(units, channel, before[channel].rmse),
                _format_error(units, channel, after[channel].rmse),
                f"{after[channel].mean:.2%}",
                f"{after[channel].largest:.2%}",
            )
            for channel in prediction.record.compared
        ]
    head = ("file", "time", "channel", "samples", "spikes excluded", "RMSE before", "RMSE after")
    return Table((*head, "mean after", "largest after"), tuple(rows))


def _format_error(units: Units, channel: str, error: float) -> str:
    return format_quantity(error, units.of(channel), 3)


def build_force_table(diagnosis: Diagnosis, names: Sequence[str]) -> Table:
    """Return the error of the force that `teleop estimate` and `run --replay` would give."""
    head = ("force at the tip in", "data", "samples", "spikes excluded", "RMSE before")
    rows = [
        (name, "validation" if force.validation else "fitted", *_format_force_errors(force))
        for name, force in zip(names, diagnosis.forces, strict=True)
    ]
    return Table((*head, "RMSE after", "mean after", "largest after"), tuple(rows))


def _format_force_errors(force: FileForce) -> tuple[str, ...]:
    after = force.after
    errors = (force.before.rmse, after.rmse, after.mean, after.largest)
    return (
        str(after.samples),
        str(after.spikes),
        *(_format_with_full_scale(error, after.full_scale) for error in errors),
    )


def build_rival_table(diagnosis: Diagnosis) -> Table:
    """Return what each rival in the model would do to the estimated force."""
    rows = [
        (
            rival.label,
            rival.replaces,
            _format_with_full_scale(rival.mean, rival.full_scale),
            _format_with_full_scale(rival.largest, rival.full_scale),
        )
        for rival in diagnosis.rival_forces
    ]
    head = ("rival", "in the place of", "mean change of the force", "largest")
    return Table(head, tuple(rows))


def build_rival_parameter_table(diagnosis: Diagnosis) -> Table:
    """Return the parameters of each rival's model, fitted to all samples."""
    names = [parameter.name for parameter in diagnosis.dataset.base.shared]
    units, rows = diagnosis.units, []
    for rival in diagnosis.rivals:
        model = rival.fit.model
        values = [
            f"{name} {format_quantity(value, units.name(parameter.unit))}"
            for name, value, parameter in zip(
                names, model.shared, diagnosis.dataset.base.shared, strict=True
            )
        ]
        for effect, numbers in model.effects:
            values += [
                f"{effect.name}.{p.name} {format_quantity(value, units.name(p.unit))}"
                for p, value in zip(effect.parameters, numbers, strict=True)
            ]
        rows.append((rival.effect.label, rival.replaces, ", ".join(values)))
    return Table(("rival", "in the place of", "parameters of its model"), tuple(rows))


def _format_with_full_scale(error: float, full_scale: float) -> str:
    share = f" ({error / full_scale:.1%})" if full_scale > 0.0 else ""
    return f"{format_quantity(error, 'N', 3)}{share}"
