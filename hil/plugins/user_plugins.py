"""What the plug-ins of an experiment fulfil, and what one of a user lacks or does wrong, in its author's words.

By these protocols the loop is composed, run and certified. Plants have theirs in :mod:`plants.parts.protocols`, controllers in
:mod:`design.controllers.contract`, network laws in :mod:`transport.laws`. A fault is one sentence instead of a traceback of our
own code.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from numbers import Integral
from typing import TYPE_CHECKING, Any, Final, Protocol, runtime_checkable

from design.controllers import Controller, LoopModel, RunningController, SeveralSamples
from hil.plugins import OUR_FOLDERS, OURS, is_ours, text_of
from hil.plugins.registry import Group
from plants.errors import PlantError

if TYPE_CHECKING:
    from traceback import FrameSummary

    from design.requests.tracking import DesignTask


@runtime_checkable
class FieldFault(Protocol):
    """A ValueError that names the field at fault, so that it is shown with its path.

    `FieldError` of plants, transport and design is one; a plug-in may raise any of them, or its own.
    """

    field: str
    message: str


@runtime_checkable
class NamedController(Protocol):
    """A controller that says under which plug-in name the log's experiment makes it again."""

    @property
    def kind(self) -> str: ...

    def start(self, model: LoopModel) -> RunningController: ...


@runtime_checkable
class GivesGains(Protocol):
    """A designer whose gains may be written down already, as printed ones are; one without this solves whenever it is asked."""

    @property
    def gains_given(self) -> bool:
        """Whether nothing is solved."""

    def solve(self, task: DesignTask) -> NamedController: ...


@runtime_checkable
class GainsOnFile(Protocol):
    """A designer whose gains may stand in a file of the user's, with the problem that they solve."""

    file: str

    def unfit(self, task: DesignTask) -> str:
        """Return in what the problem of the file differs from that of the loop; empty where it does not."""

    def solve_again(self, task: DesignTask) -> NamedController:
        """Return gains that solve what the file asks for, for the loop."""


@runtime_checkable
class Designer(Protocol):
    """A ``[controller]`` table that says what is to be achieved; what runs is what it solves to.

    It returns gains and nothing else: whether their loop is certified is said by :mod:`hil.certify.certify` alone.
    """

    def solve(self, task: DesignTask) -> NamedController:
        """Return the controller that runs.

        Raises:
            ValueError: a field that does not fit the loop; best one that `FieldFault`.
            DesignError: no gains meet the request; the message has the number that decides it.
        """


def needs(plugin: object, what: str, names: Mapping[str, str]) -> None:
    """Demand attributes of an object.

    Args:
        plugin: the object.
        what: what it is to its author, such as "what start() returns".
        names: of every attribute what it is, a noun phrase.

    Raises:
        AssertionError: with each one that is missing.
    """
    missing = []
    for name, meaning in names.items():
        try:
            getattr(plugin, name)
        except AttributeError:
            missing.append(f"`{name}` ({meaning})")
        except Exception as error:  # a property of the author's own
            raise AssertionError(f"{name} of {type(plugin).__qualname__}: {words(error)}") from error
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
    with in_own_words(f"{what}: "):
        return function(*arguments)


_STANDARD: Final = os.path.dirname(os.__file__)
"""Where the standard library lies."""

_FILES: Final = (*OUR_FOLDERS, *(f"{name}/" for name in ("hil", *OURS)))
"""How the names of our files begin in a traceback; those of compiled ones are relative."""

FORM_ERRORS: Final = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError, struct.error)
"""What our own code raises of an answer that has another form than its author's part promises."""


def user_failure(error: BaseException, objects: Iterable[object]) -> str | None:
    """Return what an exception says that came of a class of the user's own, or of what it returned; None for any other.

    Args:
        error: as it was caught.
        objects: plug-ins, ours and others'.
    """
    own = dict.fromkeys(type(made).__qualname__ for made in objects if not is_ours(made))
    if own and _frames_elsewhere(error):
        return words(error)
    if own and isinstance(error, FORM_ERRORS):
        return f"{', '.join(own)}: it returned something of another form than in its check: {words(error)}"
    return None


def words(error: BaseException) -> str:
    """Return what an exception of the user's own code says, with the line of that code that raised it.

    Args:
        error: as it was caught.
    """
    frames = _frames_elsewhere(error)
    written = [f for f in frames if not f.filename.startswith(_STANDARD) and "site-packages" not in f.filename] or frames
    where = f" ({written[-1].filename}, line {written[-1].lineno})" if written else ""  # and not of a library that raised
    return f"{type(error).__name__}: {text_of(error)}{where}"


def _frames_elsewhere(error: BaseException) -> list[FrameSummary]:
    """Return where an exception was raised, outermost first, without the frames of our packages."""
    from traceback import extract_tb

    return [frame for frame in extract_tb(error.__traceback__) if not frame.filename.startswith(_FILES)]


PLANT = {
    "inputs": "what is commanded, a tuple of plants.Signal",
    "outputs": "what is measured",
    "states": "what the log keeps",
    "model": "a method that gives the linear model that a design sees",
    "start": "a method that gives the running plant",
}


def own_fault(group: Group, plugin: Any) -> str | None:
    """Return why an object is no plant, controller or network law that a rig can run; None if it is one, or is something else.

    How a controller answers is seen once its loop is known, see `hil.compose.check_own`.

    Args:
        group: what it has to be.
        plugin: of a class of the user's own.
    """
    what = type(plugin).__qualname__
    try:
        with in_own_words():
            if group == "hil.plants":
                from plants.parts.check import check_plant

                needs(plugin, f"{what}, a plant,", PLANT)
                check_plant(plugin)
            elif group == "hil.controllers":
                if not isinstance(plugin, Controller | Designer):
                    needs(plugin, f"{what}, a controller,", {"start": "a method that returns the running controller"})
                if isinstance(plugin, SeveralSamples) and not (isinstance(plugin.samples, Integral) and plugin.samples > 0):
                    raise AssertionError(f"samples: {plugin.samples!r:.40}, expected a whole number above 0")
            elif group == "hil.laws":
                from hil.plugins.checks import check_law  # with the emulated network, which no other reading of a file needs

                check_law(plugin)
    except AssertionError as fault:
        return f"check_{group[4:-1]}: {str(fault).partition(chr(10))[0]}"  # pytest adds lines of its own
    return None


@contextmanager
def in_own_words(call: str = "") -> Iterator[None]:
    """Report whatever a user's code raises, BaseException and SystemExit too, as one AssertionError in its author's words.

    Args:
        call: what the words begin with.
    """
    try:
        yield
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        from traceback import extract_tb

        if type(error) is AssertionError and extract_tb(error.__traceback__)[-1].filename.startswith(_FILES):
            raise  # a rule of ours that is broken
        said = text_of(error) if isinstance(error, PlantError) else words(error)
        raise AssertionError(f"{call}{said}") from error
