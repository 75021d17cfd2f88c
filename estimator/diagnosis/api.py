"""A diagnosis of measured data, in one call."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType

from estimator.array_types import Array
from estimator.diagnosis import engine
from estimator.diagnosis.outcome import Diagnosis
from estimator.diagnosis.progress import quiet
from estimator.diagnosis.record import Record, RecordError, prepare
from estimator.effects import CATALOGUE, CHANNELS, Effect
from estimator.measured_data import MeasuredData

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
        Standard deviation of the noise of channels [N] and [m], where it is known better than
        `MeasuredData` tell it.
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
    several = [data] if one else data
    return engine.diagnose(
        [_record(item, noise) for item in several],  # type: ignore[union-attr, arg-type]
        tuple(map(_effect, effects)) if effects is not CATALOGUE else CATALOGUE,
        validate=[_record(item, noise) for item in validate],
        report=progress,
        workers=workers,
    )


def _record(data: MeasuredData | Record, noise: Mapping[str, float]) -> Record:
    if isinstance(data, Record):
        return data
    return prepare(data.time, signals_of(data), noise=noise)


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
