"""What the command line of every study has: options with the docstring as help, and timing."""

import argparse
import sys
import timeit
from collections.abc import Callable, Sequence
from typing import Any


def parse_options(
    description: str | None, words: Sequence[str] | None = None, /, **options: tuple[Any, str]
) -> argparse.Namespace:
    """Return the options of `python -m studies.NAME`, or of `words`; `--help` shows `description`.

    Each option is its default and what it means. The default gives the type: False makes a flag,
    a tuple takes several values, of strings these only; a type is that of an option which is None
    if it is left out.
    """
    spec = sys.modules["__main__"].__spec__
    parser = argparse.ArgumentParser(
        prog=f"python -m {spec.name.removesuffix('.__main__')}" if spec else None,
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    for name, (default, meaning) in options.items():
        flag, meaning = "--" + name.replace("_", "-"), meaning.replace("%", "%%")  # noqa: PLW2901
        if default is False:
            parser.add_argument(flag, action="store_true", help=meaning)
        elif isinstance(default, type):
            parser.add_argument(flag, type=default, metavar="VALUE", help=meaning)
        else:
            several = isinstance(default, tuple)
            shown = " ".join(map(str, default)) if several else default
            parser.add_argument(
                flag, type=type(default[0] if several else default), default=default,
                nargs="+" if several else None, metavar="VALUE",
                choices=default if several and isinstance(default[0], str) else None,
                help=f"{meaning} (default {shown})",
            )  # fmt: skip
    return parser.parse_args(words)


def measure_us(call: Callable[[], object], number: int = 1, repeat: int = 5) -> float:
    """Return the duration of a call [us]: that of the quickest of `repeat` rounds of `number`.

    The quickest leaves out whatever else runs on the machine. A first round is not counted.
    """
    return min(timeit.repeat(call, number=number, repeat=repeat + 1)[1:]) / number * 1e6
