"""Fields of a config that state their range."""

import dataclasses
from typing import Any


def build_ranged_field(default: Any, low: float, high: float, unit: str = "") -> Any:
    """Return a dataclass field whose value must be `low` to `high`; `...` for no default."""
    metadata = {"range": (low, high, unit)}
    if default is ...:
        return dataclasses.field(metadata=metadata)
    return dataclasses.field(default=default, metadata=metadata)


def check_ranges(config: Any) -> None:
    """Raise `ValueError` for a field outside its range."""
    for item in dataclasses.fields(config):
        if "range" in item.metadata:
            low, high, unit = item.metadata["range"]
            if not low <= getattr(config, item.name) <= high:
                raise ValueError(f"{item.name}: must be {low:g} to {high:g} {unit}".rstrip())
