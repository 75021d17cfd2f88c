"""Settings that may change while the slave runs: numbers of a simulated rig's environment.

Each goes to its new value linearly, in `SLEW_S`, so that the force at the tip, and with it the one
in the hand, has no step, whether the session is engaged or not. Nothing else may change: the
estimators, the control law and the gate rely on their settings.
"""

import re

from slave.rig import Rig, get_environment_setter
from teleop.config.suggestions import suggest_spelling
from teleop.errors import UsageError

NAMES = ("stiffness", "position", "damping", "dissipation")
_EXAMPLE = "slave.rig.joints.0.environment.stiffness"
_KEY = re.compile(
    r"slave\.rig\.joints\.(?P<joint>\d)\.environment\.(?:parts\.(?P<part>\d{1,2})\.)?(?P<name>\w+)",
    re.ASCII,
)


def is_live_key(key: str) -> bool:
    """Return whether a key of a config may change while the slave runs."""
    match = _KEY.fullmatch(key)
    return match is not None and match["name"] in NAMES


def change_setting(rig: Rig, key: str, value: str) -> str:
    """Let a setting of a `slave.rig.Rig` go to a value; return both as text.

    `UsageError` if the key cannot be changed while the slave runs, or not to this value.
    """
    match = _KEY.fullmatch(key)
    if match is None or match["name"] not in NAMES:
        meant = suggest_spelling(match["name"], NAMES, cutoff=0.75) if match else ""
        raise UsageError(
            f"{key}: cannot be changed while the slave runs{meant} (allowed: {', '.join(NAMES)} of "
            f"an environment, as in {_EXAMPLE})"
        )
    set_number = get_environment_setter(rig)
    if set_number is None:
        raise UsageError(f"{key}: only the environment of a simulated rig can be changed")
    try:
        number = float(value)
    except ValueError:
        raise UsageError(f"{key}: expected a number, got {value!r}") from None
    part = None if match["part"] is None else int(match["part"])
    try:
        set_number(int(match["joint"]), part, match["name"], number)
    except ValueError as error:
        raise UsageError(f"{key}: {error}") from error
    return f"{key} = {number:g}"
