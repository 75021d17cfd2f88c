"""Values as JSON has them: no numpy types, nothing that is not finite."""

import math
from typing import Any


def to_json_values(value: Any) -> Any:
    """Return a value for JSON: numpy numbers become Python's, NaN and infinity None."""
    if isinstance(value, dict):
        return {str(key): to_json_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_json_values(item) for item in value]
    if isinstance(value, str | bool | int) or value is None:
        return value
    number = float(value)
    return number if math.isfinite(number) else None
