"""A measured value, and the error that says why there is none."""

from typing import NamedTuple


class CalibrationError(ValueError):
    """Data insufficient for a calibration; the message says what is missing and what to do."""


class MeasuredValue(NamedTuple):
    """A value and its standard uncertainty, in the same unit."""

    value: float
    uncertainty: float
