"""Tables of a diagnosis by file: validation, leave-one-file-out, the force, and its rivals."""

from collections.abc import Sequence

from estimator.diagnosis.force import FileForce
from estimator.diagnosis.outcome import Diagnosis
from estimator.diagnosis.prediction import Predicted
from estimator.text_table import Table
from estimator.units import Units, quantity


def names_of(found: Diagnosis, files: Sequence[str], further: Sequence[str]) -> list[str]:
    """Return what all records are called, the fitted ones first; numbered where not given."""
    fitted = list(files) or [f"record {k + 1}" for k in range(len(found.dataset.records))]
    apart = list(further) or [f"validation {k + 1}" for k in range(len(found.validation))]
    return fitted + apart


def predicted(records: Sequence[Predicted], names: Sequence[str]) -> Table:
    """Return the errors of both models in records that were not fitted, by file and channel."""
    rows = []
    for name, one in zip(names, records, strict=True):
        before, after = one.fitness(one.before), one.fitness(one.after)
        start, units = one.record.start, one.record.units
        times = f"{start:.6g} to {start + float(one.record.time[-1]):.6g} s"
        rows += [
            (
                name,
                times,
                units.word(channel),
                str(int(one.record.good[channel].sum())),
                str(one.spikes[channel]),
                _in_units(units, channel, before[channel].rmse),
                _in_units(units, channel, after[channel].rmse),
                f"{after[channel].mean:.2%}",
                f"{after[channel].largest:.2%}",
            )
            for channel in one.record.compared
        ]
    head = ("file", "time", "channel", "samples", "spikes excluded", "RMSE before", "RMSE after")
    return Table((*head, "mean after", "largest after"), tuple(rows))


def _in_units(units: Units, channel: str, error: float) -> str:
    return quantity(error, units.of(channel), 3)


def forces(found: Diagnosis, names: Sequence[str]) -> Table:
    """Return the error of the force that `teleop estimate` and `run --replay` would give."""
    head = ("force at the tip in", "data", "samples", "spikes excluded", "RMSE before")
    rows = [
        (name, "validation" if one.validation else "fitted", *_force(one))
        for name, one in zip(names, found.forces, strict=True)
    ]
    return Table((*head, "RMSE after", "mean after", "largest after"), tuple(rows))


def _force(one: FileForce) -> tuple[str, ...]:
    after = one.after
    errors = (one.before.rmse, after.rmse, after.mean, after.largest)
    return (
        str(after.samples),
        str(after.spikes),
        *(_of_scale(error, after.full_scale) for error in errors),
    )


def rivals(found: Diagnosis) -> Table:
    """Return what each rival in the model would do to the estimated force."""
    rows = [
        (
            one.label,
            one.replaces,
            _of_scale(one.mean, one.full_scale),
            _of_scale(one.largest, one.full_scale),
        )
        for one in found.rival_forces
    ]
    head = ("rival", "in the place of", "mean change of the force", "largest")
    return Table(head, tuple(rows))


def rival_parameters(found: Diagnosis) -> Table:
    """Return the parameters of each rival's model, fitted to all samples."""
    names = [parameter.name for parameter in found.dataset.base.shared]
    units, rows = found.units, []
    for one in found.rivals:
        model = one.fit.model
        values = [
            f"{name} {quantity(value, units.name(parameter.unit))}"
            for name, value, parameter in zip(
                names, model.shared, found.dataset.base.shared, strict=True
            )
        ]
        for effect, numbers in model.effects:
            values += [
                f"{effect.name}.{p.name} {quantity(value, units.name(p.unit))}"
                for p, value in zip(effect.parameters, numbers, strict=True)
            ]
        rows.append((one.effect.label, one.replaces, ", ".join(values)))
    return Table(("rival", "in the place of", "parameters of its model"), tuple(rows))


def _of_scale(error: float, full_scale: float) -> str:
    share = f" ({error / full_scale:.1%})" if full_scale > 0.0 else ""
    return f"{quantity(error, 'N', 3)}{share}"
