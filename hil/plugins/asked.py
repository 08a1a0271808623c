"""What a plug-in of somebody's own lacks or does wrong, in its author's words: never an error or a line of our own code."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from hil.plugins.shadowed_packages import OUR_FOLDERS


def needs(made: object, what: str, names: Mapping[str, str]) -> None:
    """Demand attributes of an object.

    Args:
        made: the object.
        what: what it is to its author, such as "what start() returns".
        names: of every attribute what it is, a noun phrase.

    Raises:
        AssertionError: with each one that is missing.
    """
    missing = []
    for name, meaning in names.items():
        try:
            getattr(made, name)
        except AttributeError:
            missing.append(f"`{name}` ({meaning})")
        except Exception as error:  # a property of the author's own
            raise AssertionError(f"{name} of {type(made).__qualname__}: {words(error)}") from error
    if missing:
        raise AssertionError(f"{what} needs {', '.join(missing)}")


def asked(what: str, function: Callable[..., Any], *arguments: Any) -> Any:
    """Return what a function of the author's own returns.

    Args:
        what: the call as its author knows it, such as "start(rng)".
        function: what is called.
        arguments: what it is given.

    Raises:
        AssertionError: it raised, with its error and the line of its author.
    """
    try:
        return function(*arguments)
    except (AssertionError, KeyboardInterrupt):
        raise
    except BaseException as error:  # whatever a stranger's code raises, SystemExit too
        raise AssertionError(f"{what}: {words(error)}") from error


def told_of(error: BaseException, objects: Iterable[object]) -> str | None:
    """Return what an exception says that came of a class of the user's own, None for any other exception.

    Args:
        error: as it was caught.
        objects: plug-ins, ours and others'.
    """
    modules = (sys.modules.get(type(made).__module__) for made in objects)
    files = {str(getattr(module, "__file__", None)) for module in modules}
    theirs = {file for file in files if not file.startswith(OUR_FOLDERS)}
    frames = traceback.extract_tb(error.__traceback__)
    return words(error) if any(frame.filename in theirs for frame in frames) else None


def words(error: BaseException) -> str:
    """Return what an exception of the user's own code says, with the line of that code that raised it.

    Args:
        error: as it was caught.
    """
    frames = [f for f in traceback.extract_tb(error.__traceback__) if not f.filename.startswith(OUR_FOLDERS)]
    where = f" ({frames[-1].filename}, line {frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {error}{where}"
