"""What a part of the user's own raises when it is asked: one message with its path and its line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from traceback import walk_tb

from hil.errors import ExperimentError, HilError
from hil.experiment import Experiment
from hil.plugins.user_plugins import told_of


@contextmanager
def in_words_of_parts(experiment: Experiment) -> Iterator[None]:
    """Say of which part of the user's own an exception comes that was not foreseen, and in which line: before anything runs.

    Raises:
        ExperimentError: the exception came of plant, controller or a network law that is not ours.
    """
    try:
        yield
    except HilError:
        raise
    except Exception as error:  # whatever an author's part raises when it is asked
        text = told_of(error, _parts(experiment).values())
        if text is None:
            raise
        asked = [frame.f_locals.get("self") for frame, _ in walk_tb(error.__traceback__)]
        paths = [path for path, part in _parts(experiment).items() if any(part is each for each in asked)]
        raise ExperimentError(experiment.name, [f"{paths[0] if paths else 'a plug-in'}: {text}"]) from error


def _parts(e: Experiment) -> dict[str, object]:
    laws = {f"network.nodes.{name}.law": node.law for name, node in e.network.nodes.items()}
    ends = {"network.sc.law": e.network.sc.law, "network.ca.law": e.network.ca.law}
    return {"plant": e.plant, "controller": e.controller, **ends, **laws}
