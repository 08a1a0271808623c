"""Numbers by name, where a name that is not there is answered with those that are."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import TypeVar

from hil.errors import HilError

T = TypeVar("T")


class UnknownName(HilError, KeyError):
    """A name that is none of those that are there."""

    __str__ = Exception.__str__  # a KeyError would print its text in quotes


def unknown_name(what: str, name: object, known: Iterable[str]) -> UnknownName:
    """Return the error for a name, with the nearest one and all that are there.

    >>> print(unknown_name("metric", "settling_tme_s", ["sse", "settling_time_s"]))
    no metric is called 'settling_tme_s'; did you mean 'settling_time_s'? There are: sse, settling_time_s
    """
    names = list(known)
    near = difflib.get_close_matches(str(name), names, n=1)
    hint = f"; did you mean {near[0]!r}?" if near else "."
    return UnknownName(f"no {what} is called {str(name)!r}{hint} There are: {', '.join(names) or 'none'}")


class Named(dict[str, T]):
    """A dictionary of numbers whose error names those that are there.

    Args:
        what: one of them in a word.
        found: the numbers.
    """

    def __init__(self, what: str, found: dict[str, T]) -> None:
        super().__init__(found)
        self.what = what

    def __missing__(self, name: str) -> T:
        raise unknown_name(self.what, name, self)

    def __reduce__(self) -> tuple[type[Named[T]], tuple[str, dict[str, T]]]:
        return Named, (self.what, dict(self))
