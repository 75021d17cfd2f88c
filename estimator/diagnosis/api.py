"""A diagnosis of measured data, in one call."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType

from estimator.array_types import Array
from estimator.diagnosis import engine
from estimator.diagnosis.force import compute_file_force, compute_rival_force
from estimator.diagnosis.model import BaseLaw
from estimator.diagnosis.outcome import Diagnosis
from estimator.diagnosis.record import (
    Record,
    RecordError,
    check_finite_values,
    is_loop,
    prepare_record,
)
from estimator.diagnosis.rivals import CauseError
from estimator.diagnosis.sampling import mark_missing
from estimator.diagnosis.settings import ignore_progress
from estimator.effects import CATALOGUE, CHANNELS, Effect
from estimator.measured_data import MeasuredData
from estimator.units import LINEAR, Units

__all__ = ["CauseError", "RecordError", "diagnose"]


def diagnose(
    data: MeasuredData | Record | Sequence[MeasuredData | Record],
    effects: Iterable[str | Effect] = CATALOGUE,
    *,
    validate: Sequence[MeasuredData | Record] = (),
    noise: Mapping[str, float] = MappingProxyType({}),
    cause: str = "",
    fit_all: bool = False,
    leave_one_file_out: bool = False,
    loop: bool | None = None,
    progress: Callable[[str, float], None] = ignore_progress,
    workers: int = 1,
) -> Diagnosis:
    """Find what the law gets wrong on measured data, the cause, and what modelling it gains.

    Candidates are compared by held-out log-likelihood with a BIC penalty (docs/diagnosis.md).

    Parameters
    ----------
    data : MeasuredData, Record, or a sequence of them
        Of one bench, with the same channels; they are fitted together. A `Record` is data that
        `estimator.diagnosis.record.prepare_record` has checked.
    effects : iterable of str or Effect
        Candidate causes, by name or from `CATALOGUE`.
    validate : sequence of MeasuredData or Record
        Further data of the bench, to be predicted and not fitted.
    noise : mapping
        Standard deviation of the noise of channels in the data's units, where it is known better
        than `MeasuredData` tell it.
    cause : str
        Name of the effect to be taken where several explain the data equally well.
    fit_all : bool
        Fit and judge all samples; none is held out.
    leave_one_file_out : bool
        Also predict each record by the fit of the others.
    loop : bool, optional
        Whether the data are of a closed loop of two cables; by default, whether effort changes its
        sign in one of them.
    progress : callable
        Called with what is being done and which share of it (0 to 1) is.
    workers : int
        Threads that fit side by side.

    Returns
    -------
    Diagnosis
        With `verdict`, `causes`, `parameters`, `gain`, `summary()` and `plot()`; in a notebook it
        draws itself.

    Raises
    ------
    RecordError
        If the data cannot be diagnosed; the message says why.
    CauseError
        If `cause` is not among the effects that explain the data equally well.
    ValueError
        If an effect is not in the catalogue.
    """
    is_single = isinstance(data, Record) or hasattr(data, "proximal_tension")
    data_sets: list[MeasuredData | Record] = [data] if is_single else list(data)  # type: ignore[list-item, arg-type]
    records = prepare_records([*data_sets, *validate], noise, loop=loop)
    diagnosis = engine.diagnose(
        records[: len(data_sets)],
        tuple(map(_resolve_effect, effects)) if effects is not CATALOGUE else CATALOGUE,
        validate=records[len(data_sets) :],
        cause=cause,
        fit_all=fit_all,
        leave_one_file_out=leave_one_file_out,
        report=progress,
        workers=workers,
    )
    progress("estimating the force", 1.0)
    return _add_forces(diagnosis, data_sets, validate)


def _add_forces(
    diagnosis: Diagnosis,
    data: Sequence[MeasuredData | Record],
    validate: Sequence[MeasuredData | Record],
) -> Diagnosis:
    """Return a diagnosis with the forces that its models would estimate in data that are given.

    The estimator runs the capstan law of one tendon only.
    """
    if diagnosis.units.rotary or diagnosis.dataset.records[0].loop:
        return diagnosis
    if diagnosis.dataset.base.law is not BaseLaw.CAPSTAN:
        return diagnosis
    base_model, model = diagnosis.baseline.model, diagnosis.extended.model
    fitted_data = [item for item in data if not isinstance(item, Record)]
    validation_data = [item for item in validate if not isinstance(item, Record)]
    tagged_data = [(item, False) for item in fitted_data] + [
        (item, True) for item in validation_data
    ]
    forces = [
        compute_file_force(base_model, model, diagnosis.duration, item, validation=is_validation)
        for item, is_validation in tagged_data
    ]
    names = [(rival.replaces, rival.effect.label) for rival in diagnosis.rivals]
    return diagnosis._replace(
        forces=tuple(item for item in forces if item is not None),
        rival_forces=tuple(
            compute_rival_force(model, rival.fit.model, name, diagnosis.duration, fitted_data)
            for rival, name in zip(diagnosis.rivals, names, strict=True)
            if fitted_data
        ),
    )


def prepare_records(
    data: Sequence[MeasuredData | Record],
    noise: Mapping[str, float] = MappingProxyType({}),
    *,
    loop: bool | None = None,
) -> list[Record]:
    """Return records of one bench made ready: in common units, all of a loop or none.

    Parameters
    ----------
    data : sequence of MeasuredData or Record
        A `Record` is taken as it is.
    noise : mapping
        As for `diagnose`.
    loop : bool, optional
        Whether they are of a closed loop of two cables; by default, whether effort changes its sign
        in one of them.

    Raises
    ------
    RecordError
        If one cannot be diagnosed or is in other units than the first.
    """
    raw_data = [item for item in data if not isinstance(item, Record)]
    signals = [mark_missing(collect_signals(item)) for item in raw_data]
    for channels in signals:
        check_finite_values(channels)
    if not raw_data:
        return [item for item in data if isinstance(item, Record)]
    units = get_units(raw_data[0])
    if any(get_units(item) != units for item in raw_data):
        raise RecordError("torque and angle beside tension and travel: give data of one bench")
    loop = is_loop(units, signals) if loop is None else loop
    records = []
    for item in data:
        if isinstance(item, Record):
            records.append(item)
            continue
        try:
            records.append(
                prepare_record(
                    item.time, collect_signals(item), noise=noise, units=units, loop=loop
                )
            )
        except RecordError as error:
            path = getattr(item, "path", None)
            raise RecordError(f"{path}: {error}" if path else str(error)) from error
    return records


def get_units(data: MeasuredData) -> Units:
    """Return the units of data; newtons and metres where they name none."""
    units: Units = getattr(data, "units", LINEAR)
    return units


def collect_signals(data: MeasuredData) -> dict[str, Array]:
    """Return the channels that were measured, by name."""
    return {name: signal for name in CHANNELS if (signal := getattr(data, name)) is not None}


def _resolve_effect(effect: str | Effect) -> Effect:
    if isinstance(effect, Effect):
        return effect
    matches = [candidate for candidate in CATALOGUE if candidate.name == effect]
    if not matches:
        names = ", ".join(dict.fromkeys(candidate.name for candidate in CATALOGUE))
        raise ValueError(f"effect {effect!r}: not in the catalogue, which has {names}")
    return matches[0]
