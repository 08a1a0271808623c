"""Whether a sweep has the numbers of single runs, where a part of the loop is not ours: of those the first run is made alone.

That ours have them, bit for bit, tests hold. An own plant may inherit `start_batch` from one of ours and move otherwise, or be
another one once it was pickled for a worker.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import isnan

from hil.compose.loop import Loop
from hil.errors import HilError
from hil.measure.measure import measures_of
from hil.plugins.shadowed_packages import is_ours
from hil.sweeps.lockstep import measures_in_lockstep, supports_batch


def foreign_parts(loop: Loop) -> tuple[str, ...]:
    """Return the classes of plant, controller, network laws and measures that are not ours, by name."""
    parts = (loop.experiment.plant, loop.controller, *loop.rig.laws, *measures_of(loop.experiment))
    return tuple(dict.fromkeys(type(part).__qualname__ for part in parts if not is_ours(part)))


def copied(loop: Loop) -> Loop:
    """Return a loop as a worker gets it."""
    from cloudpickle import dumps, loads

    copy: Loop = loads(dumps(loop))
    return copy


def refuse_other_numbers(loop: Loop, alone: Mapping[str, float], found: Mapping[str, float]) -> None:
    """Refuse a sweep whose first run has other numbers than it has alone.

    Args:
        loop: what is swept.
        alone: numbers of a run of one seed.
        found: those of the same seed in the sweep.

    Raises:
        HilError: with the number that differs most plainly: the first one.
    """
    if alone["seed"] != found["seed"]:
        return  # a sweep that goes on where another one ended
    for name, value in alone.items():
        other = found[name]
        if not (value == other or (isnan(value) and isnan(other))):
            at_once = supports_batch(loop) and measures_in_lockstep(loop)
            why = "start_batch(), ages_of_batch() or of_batch()" if at_once else "what is left of it when pickled"
            raise HilError(
                f"{', '.join(foreign_parts(loop))}: a sweep has other numbers than its runs: {name} of seed "
                f"{alone['seed']:.0f} is {other:.6g} in the sweep and {value:.6g} in a run of its own; mend {why}"
            )
