"""What the source of a class says of its fields, in the comments behind or above each."""

import ast
import inspect
import io
import textwrap
import tokenize


def read_field_comments(cls: type) -> dict[str, str]:
    """Return the comment of each annotated field of a class and its bases, where there is one.

    It stands behind the field, on any of its lines, or in whole lines above it. A comment for a
    tool (`noqa`) is none. A field that is declared again without a comment keeps its base's.
    """
    comments: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        if "__annotations__" in vars(base):
            comments |= _read_own_comments(base)
    return comments


def _read_own_comments(cls: type) -> dict[str, str]:
    """Return the comments in the body of one class."""
    try:
        source = textwrap.dedent(inspect.getsource(cls))
    except OSError:  # an extension, installed without its source
        return {}
    behind, whole = _list_comments(source)
    (definition,) = ast.parse(source).body
    comments = {}
    for item in getattr(definition, "body", ()):
        if not (isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name)):
            continue
        last = item.end_lineno or item.lineno
        lines = [behind.get(n) or whole.get(n) for n in range(item.lineno, last + 1)]
        above = item.lineno - 1
        while above in whole:
            lines.insert(0, whole[above])
            above -= 1
        text = " ".join(filter(None, lines))
        if text:
            comments[item.target.id] = text
    return comments


def _list_comments(source: str) -> tuple[dict[int, str], dict[int, str]]:
    """Return the comments behind code and those of whole lines, by line."""
    behind: dict[int, str] = {}
    whole: dict[int, str] = {}
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            text = token.string.partition("# noqa")[0].strip("# ")
            is_whole = token.line[: token.start[1]].strip() == ""
            (whole if is_whole else behind)[token.start[0]] = text
    return behind, whole
