"""Words that are nearly right: which effect, or key, was meant."""

import difflib
from collections.abc import Iterable, Sequence

from estimator.effects import CATALOGUE, NAMES, Effect
from teleop.errors import UsageError

MOST = 3  # names that are suggested


def nearest(word: str, allowed: Iterable[str]) -> str:
    """Return a hint at what may have been meant, to be put behind a complaint."""
    close = difflib.get_close_matches(word, list(allowed), MOST, 0.5)
    return f"; is it {' or '.join(close)}?" if close else ""


def chosen(text: str) -> Sequence[Effect]:
    """Return the effects that `--effects` means: names with commas between them, or all."""
    if text.strip() == "all":
        return CATALOGUE
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise UsageError("--effects: names of effects with commas between them, or all")
    for name in names:
        if name not in NAMES:
            listed = nearest(name, NAMES) or f"; there are {', '.join(NAMES)}"
            raise UsageError(f"--effects {name}: there is no such effect{listed}")
    return tuple(effect for effect in CATALOGUE if effect.name in names)
