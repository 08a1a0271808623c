"""Every number of the shipped experiments, replaced by an unexpected one: the run goes on, or is refused with one message.

Nothing else is said: a warning of numpy's or scipy's on the terminal is a failure, too.
"""

from __future__ import annotations

import tomllib
import warnings
from collections.abc import Iterator
from itertools import product
from random import Random
from typing import Any

import pytest

import hil
from hil.errors import HilError
from hil.experiment import load_experiment, shipped
from plants.errors import PlantError
from tests.hostile.tally import Note, Tally

FEW = 60
PARTS = 4
SHORT = "duration=0.2 s"
WORK_S = 60.0
"""Of one input: gains of some experiments are solved again, in some seconds."""

NUMBERS = (0, -1, 1, 1e-300, 1e-99, 1e-12, 1e-9, 1e9, 1e20, 1e29, 1e31, 1e80, 1e160, 1e308, -1e308)
WITH_DEFAULTS = (
    "dc-motor-1khz", "dc-motor-hinf-friction", "dc-motor-packets", "dc-motor-smith", "dc-motor-two-nodes", "multisensor-event",
    "omni-push", "omni-slide", "omni-wifi", "smjls-robust-published", "vtol-fault-published", "vtol-hinf",
)  # fmt: skip
"""Of these the numbers that their files leave out are replaced, too; gains of the others are solved for each plant anew."""

Input = tuple[str, str, str]


def _leaves(tree: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    if isinstance(tree, dict):
        for key, value in tree.items():
            yield from _leaves(value, (*path, key))
    else:
        yield path, tree


def _with(number: float, value: Any) -> Any:
    """Return a value with each of its numbers replaced, in TOML; None if it has none."""
    if isinstance(value, list):
        inner = [_with(number, entry) for entry in value]
        return None if not inner or None in inner else f"[{', '.join(inner)}]"
    if isinstance(value, bool) or not isinstance(value, int | float):
        words = value.split() if isinstance(value, str) else []
        return f'"{number!r} {words[1]}"' if len(words) == 2 and words[0].replace(".", "").isdigit() else None
    return repr(number)


def _inputs() -> list[Input]:
    found = []
    for name, file in sorted(shipped().items()):
        tree = tomllib.loads(file.read_text())
        leaves = dict(_leaves(load_experiment(name).resolved() if name in WITH_DEFAULTS else {})) | dict(_leaves(tree))
        for (path, value), number in product(leaves.items(), NUMBERS):
            text = _with(number, value)
            if text is not None:
                found.append((name, ".".join(path), text))
    return found


def _attack(given: list[Input], note: Note) -> None:
    tally = Tally("number", (HilError, PlantError), WORK_S)
    for name, path, text in given:
        sets = [f"{path}={text}", *([] if path == "duration" else [SHORT])]
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            tally.attack(lambda sets=sets, name=name: hil.simulate(load_experiment(name, sets)), (name, path, text))
    tally.end(note)


def test_an_unusual_number_is_run_or_refused_with_one_message(record_property: Note) -> None:
    _attack(Random(11).sample(_inputs(), FEW), record_property)


@pytest.mark.hostile
@pytest.mark.parametrize("part", range(PARTS))
def test_every_number_of_every_experiment_is_run_or_refused_with_one_message(part: int, record_property: Note) -> None:
    _attack(_inputs()[part::PARTS], record_property)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("dc-motor-local", "controller.gain=[[1e29]]"),
        ("omni-1khz", "plant.hand.damping_n_s_per_m=1e9"),
        ("omni-wifi", "plant.hand.slide.turn_s=1e-9"),
        ("omni-wifi", "plant.hand.push={tremor_n=1.0, tremor_hold_s=1e-9}"),
        ("vtol-delayed", "controller.gain_bound=1e20"),
        ("dc-motor-local", "controller.gain=[[1e160]]"),
        ("omni-push", "plant.lever_m=1e-300"),
        ("omni-wifi", "plant.hand.approach_s=1e-300"),
        ("vtol-fault-published", "plant.noise_period_s=1e308"),
        ("dc-motor-wifi", 'network.ca.law.latency.scale="1e308 ms"'),
        ("dc-motor-wifi", "network.sc.law.latency.s=1e9"),
        ("dc-motor-wifi", "network.sc.law.loss.p_gb=0"),
        ("dc-motor-packets", "network.sc.max_age=0"),
    ],
)
def test_what_once_crashed_hung_or_warned(name: str, change: str, record_property: Note) -> None:
    path, _, text = change.partition("=")
    _attack([(name, path, text)], record_property)
