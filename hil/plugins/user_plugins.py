"""What a plug-in of somebody's own has to be before it runs, told in one sentence instead of a traceback."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from design.controllers import Controller
from hil.plugins.asked import needs, words
from hil.plugins.protocols import Designer
from hil.plugins.registry import Group
from plants.errors import PlantError
from plants.parts.check import check_plant

__all__ = ["in_own_words", "own_fault", "words"]

PLANT = {
    "inputs": "what is commanded, a tuple of plants.Signal",
    "outputs": "what is measured",
    "states": "what the log keeps",
    "model": "a method that gives the linear model that a design sees",
    "start": "a method that gives the running plant",
}


def own_fault(group: Group, made: object) -> str | None:
    """Return why an object is no plant, controller or network law that a rig can run; None if it is one, or is something else.

    Args:
        group: what it has to be.
        made: of a class of the user's own.
    """
    checks: dict[Group, Callable[[Any], None]] = {
        "hil.plants": _check_plant, "hil.controllers": _check_controller, "hil.laws": _check_law,
    }  # fmt: skip
    if group not in checks:
        return None
    name = {"hil.plants": "plant", "hil.controllers": "controller", "hil.laws": "law"}[group]
    try:
        with in_own_words():
            checks[group](made)
    except AssertionError as fault:
        return f"check_{name}: {str(fault).partition(chr(10))[0]}"  # pytest adds lines of its own
    return None


@contextmanager
def in_own_words() -> Iterator[None]:
    """Tell whatever a stranger's code raises, BaseException and SystemExit too, as one AssertionError in its author's words."""
    try:
        yield
    except (AssertionError, KeyboardInterrupt):
        raise
    except PlantError as error:
        raise AssertionError(str(error)) from error
    except BaseException as error:
        raise AssertionError(words(error)) from error


def _check_plant(made: Any) -> None:
    needs(made, f"{type(made).__qualname__}, a plant,", PLANT)
    check_plant(made)


def _check_controller(made: Any) -> None:
    """See that it is one; how it answers is seen once its loop is known, see `hil.compose.fit.check_own`."""
    if not isinstance(made, Controller | Designer):
        needs(made, f"{type(made).__qualname__}, a controller,", {"start": "a method that returns the running controller"})


def _check_law(made: Any) -> None:
    from hil.plugins.law_checks import check_law  # with the emulated network, which no other reading of a file needs

    check_law(made)
