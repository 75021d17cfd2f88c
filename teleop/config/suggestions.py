"""A hint at what a misspelt word may have meant."""

from collections.abc import Iterable


def suggest_spelling(
    word: str, allowed: Iterable[str], number: int = 1, cutoff: float = 0.6
) -> str:
    """Return a hint to put behind an error, empty if no allowed word is close.

    At most `number` words are suggested, of a similarity of at least `cutoff`, from 0 to 1
    (`difflib.get_close_matches`).
    """
    import difflib  # slow to import, and needed only for a mistake

    close = difflib.get_close_matches(word, list(allowed), number, cutoff)
    return f"; did you mean {' or '.join(map(repr, close))}?" if close else ""
