"""Which exceptions of a run are those of a part of its loop, and what they say."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from hil.log import PLANT_FAILED, PLUG_IN_FAILED
from hil.plugins.user_plugins import user_failure
from hil.rig.loop import Loop
from plants.errors import PlantError


def failure_of(loop: Loop, error: BaseException, *others: object) -> tuple[str, str] | None:
    """Return the kind of the event that an exception is, and what it says; None for one that no part of the loop raised.

    Args:
        loop: what ran.
        error: as it was caught.
        others: what ran beside it and may be a user's own, such as the link.
    """
    if isinstance(error, PlantError):
        return PLANT_FAILED, str(error)
    parts = (loop.experiment.plant, loop.controller, *loop.rig.laws, *others)
    text = None if isinstance(error, KeyboardInterrupt) else user_failure(error, parts)
    return None if text is None else (PLUG_IN_FAILED, text.encode("utf-8", "backslashreplace").decode())


@contextmanager
def failing(loop: Loop, said: Callable[[str, str], object], *others: object) -> Iterator[None]:
    """Say which part of a loop raised within, and what; any other exception goes on.

    Args:
        loop, others: as of `failure_of`.
        said: called with what that returns.
    """
    try:
        yield
    except BaseException as error:
        failure = failure_of(loop, error, *others)
        if failure is None:
            raise
        said(*failure)
