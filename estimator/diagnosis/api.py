"""A diagnosis of measured data, in one call."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType

from estimator.array_types import Array
from estimator.diagnosis import engine
from estimator.diagnosis.outcome import Diagnosis
from estimator.diagnosis.progress import quiet
from estimator.diagnosis.record import Record, RecordError, efforts_of, is_loop, prepare
from estimator.effects import CATALOGUE, CHANNELS, Effect
from estimator.measured_data import MeasuredData
from estimator.units import LINEAR, Units

__all__ = ["RecordError", "diagnose"]


def diagnose(
    data: MeasuredData | Record | Sequence[MeasuredData | Record],
    effects: Iterable[str | Effect] = CATALOGUE,
    *,
    validate: Sequence[MeasuredData | Record] = (),
    noise: Mapping[str, float] = MappingProxyType({}),
    progress: Callable[[str, float], None] = quiet,
    workers: int = 1,
) -> Diagnosis:
    """Find what the law gets wrong on measured data, the cause, and what modelling it gains.

    Candidates are compared by held-out log-likelihood with a BIC penalty (docs/diagnosis.md).

    Parameters
    ----------
    data : MeasuredData, Record, or a sequence of them
        Of one bench, with the same channels; they are fitted together. A `Record` is data that
        `estimator.diagnosis.record.prepare` has checked.
    effects : iterable of str or Effect
        Candidate causes, by name or from `CATALOGUE`.
    validate : sequence of MeasuredData or Record
        Further data of the bench, to be predicted and not fitted.
    noise : mapping
        Standard deviation of the noise of channels in the data's units, where it is known better
        than `MeasuredData` tell it.
    progress : callable
        Called with what is being done and which share of it (0 to 1) is.
    workers : int
        Processes that fit side by side.

    Returns
    -------
    Diagnosis
        With `verdict`, `causes`, `parameters`, `gain` and `summary()`.

    Raises
    ------
    RecordError
        If the data cannot be diagnosed; the message says why.
    ValueError
        If an effect is not in the catalogue.
    """
    one = isinstance(data, Record) or hasattr(data, "proximal_tension")
    several = [data] if one else [*data]  # type: ignore[misc]
    records = records_of([*several, *validate], noise)  # type: ignore[list-item]
    return engine.diagnose(
        records[: len(several)],
        tuple(map(_effect, effects)) if effects is not CATALOGUE else CATALOGUE,
        validate=records[len(several) :],
        report=progress,
        workers=workers,
    )


def records_of(
    data: Sequence[MeasuredData | Record],
    noise: Mapping[str, float] = MappingProxyType({}),
    names: Sequence[str] = (),
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
    names : sequence of str
        What errors call the data.
    loop : bool, optional
        Whether they are of a closed loop of two cables; by default, whether effort changes its sign
        in one of them.

    Raises
    ------
    RecordError
        If one cannot be diagnosed or is in other units than the first.
    """
    raw = [one for one in data if not isinstance(one, Record)]
    signals = [signals_of(one) for one in raw]
    if not raw:
        return [one for one in data if isinstance(one, Record)]
    units = units_of(raw[0])
    if any(units_of(one)[:2] != units[:2] for one in raw):
        raise RecordError("torque and angle beside tension and travel: give data of one bench")
    units = units.scaled_to(effort for one in signals for effort in efforts_of(one))
    loop = is_loop(units, signals) if loop is None else loop
    records = []
    for i, one in enumerate(data):
        if isinstance(one, Record):
            records.append(one)
            continue
        try:
            records.append(prepare(one.time, signals_of(one), noise=noise, units=units, loop=loop))
        except RecordError as error:
            raise RecordError(f"{names[i]}: {error}" if names else str(error)) from error
    return records


def units_of(data: MeasuredData) -> Units:
    """Return the units of data; newtons and metres where they name none."""
    units: Units = getattr(data, "units", LINEAR)
    return units


def signals_of(data: MeasuredData) -> dict[str, Array]:
    """Return the channels that were measured, by name."""
    return {name: signal for name in CHANNELS if (signal := getattr(data, name)) is not None}


def _effect(effect: str | Effect) -> Effect:
    if isinstance(effect, Effect):
        return effect
    found = [known for known in CATALOGUE if known.name == effect]
    if not found:
        names = ", ".join(dict.fromkeys(known.name for known in CATALOGUE))
        raise ValueError(f"effect {effect!r}: not in the catalogue, which has {names}")
    return found[0]
