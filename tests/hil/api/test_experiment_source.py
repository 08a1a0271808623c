"""What a caller hands over by mistake is one error that says what is expected, and never a traceback of ours."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import hil
from hil.errors import HilError
from hil.session import Session
from plants import DCMotor

WRONG = [None, 3, 2.5, True, {}, {"plant": 1}, [], ["dc-motor-h2"], ("dc-motor-h2",), {"a"}, b"x", object(), np.zeros(3)]
CALLS: dict[str, Callable[..., Any]] = {
    "run": hil.run, "simulate": hil.simulate, "sweep": hil.sweep, "compare": hil.compare, "design": hil.design, "laws": hil.laws,
    "load_experiment": hil.load_experiment, "verify": hil.verify, "read_run": hil.read_run, "report": hil.report,
}  # fmt: skip


@pytest.fixture(scope="module")
def session() -> Session:
    return hil.run("dc-motor-h2", duration=1)


@pytest.mark.parametrize("name", CALLS)
def test_a_source_of_another_kind_is_one_error(name: str) -> None:
    for wrong in WRONG:
        with pytest.raises(hil.HilError, match=rf"{name}: (source|sources|log|path): .*; expected ") as reported:
            CALLS[name](wrong)
        assert "\n" not in str(reported.value)


def test_a_chapter_of_another_kind_is_one_error() -> None:
    for wrong in WRONG:
        with pytest.raises(hil.HilError, match="no chapter is called"):
            hil.reproduce(wrong)  # type: ignore[arg-type]


def test_experiments_of_a_comparison_stand_for_themselves() -> None:
    with pytest.raises(hil.HilError) as reported:
        hil.compare({"a": "dc-motor-h2", "b": "dc-motor-hinf"})  # type: ignore[arg-type]
    assert str(reported.value) == (
        "hil.compare: sources: a dict; expected the name of an experiment, the path of its file or what load_experiment "
        "returned; hand over each as an argument of its own"
    )


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"seed": "x"}, "hil.run: seed: 'x'; expected a whole number or None"),
        ({"seed": True}, "hil.run: seed: True; expected a whole number or None"),
        ({"clock": "fast"}, "hil.run: clock: 'fast'; expected 'virtual' or 'real'"),
        ({"log": 3}, "hil.run: log: 3; expected text, a path or None"),
        ({"external": "yes"}, "hil.run: external: 'yes'; expected True or False"),
        ({"wait": "long", "external": True, "clock": "real"}, "hil.run: wait: 'long'; expected a number or None"),
        ({"wait": 5.0}, "hil.run: wait: only with external=True; it is how long the rig waits for your program"),
        ({"wait": 0, "external": True, "clock": "real"}, "hil.run: wait: 0; expected more than 0 s and at most 1e+08 s"),
        ({"signals": "x", "clock": "real"}, "signals 'x': expected zenoh:"),
        ({"controller": ("a",)}, "controller: ('a',); expected a gain, a matrix (m, p) of numbers, or an object"),
    ],
)
def test_an_option_of_another_kind_is_one_error(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(hil.HilError) as reported:
        hil.run("dc-motor-h2", **changes)
    assert str(reported.value).startswith(said)


@pytest.mark.parametrize(
    ("option", "value", "expected"),
    [
        ("R", "x", "numbers"), ("Q", object(), "numbers"), ("initial", [["a"]], "numbers"), ("starts", "a", "a whole number"),
        ("seed", None, "a whole number"), ("samples", 1.5, "a whole number"), ("integral", "a", "a number"),
        ("gain_bound", "a", "a number"),
    ],
)  # fmt: skip
def test_an_option_of_a_design_is_named_with_what_it_expects(option: str, value: object, expected: str) -> None:
    with pytest.raises(hil.HilError, match=f"^design: {option}: .*, expected {expected}$"):
        hil.design("dc-motor", **{option: value})


def test_numbers_that_cannot_run_are_refused() -> None:
    for call in (
        lambda: hil.sweep("dc-motor-h2", runs=10**30), lambda: hil.sweep("dc-motor-h2", runs=2, jobs=0),
        lambda: hil.compare("dc-motor-h2", "dc-motor-hinf", runs=10**30), lambda: hil.sweep("dc-motor-h2", jobs=10**30),
        lambda: hil.design("dc-motor", sojourns=0), lambda: hil.design("dc-motor", period=10**30),
        lambda: hil.sweep("dc-motor-h2", grid=3), lambda: hil.load_experiment("dc-motor-h2", [3]),  # type: ignore[arg-type, list-item]
        lambda: hil.sweep("dc-motor-h2", grid={3: [1]}),  # type: ignore[dict-item]
        lambda: hil.load_experiment("dc-motor-h2", "seed=3"), lambda: hil.simulate("dc-motor-h2", topics=["/plant/measurment"]),
    ):  # fmt: skip
        with pytest.raises(hil.HilError):
            call()


def test_numbers_of_numpy_are_numbers(session: Session) -> None:
    assert hil.run("dc-motor-h2", seed=np.int64(0), duration=np.float64(1.0)).metrics == session.metrics  # type: ignore[arg-type]
    assert hil.run.__wrapped__.__name__ == hil.run.__name__  # type: ignore[attr-defined]  # signature and documentation stay


@pytest.mark.parametrize("path", ["links.sc.law", "network.sc", "law"])
def test_an_object_in_a_wrong_place_is_refused_with_the_right_places(path: str) -> None:
    with pytest.raises(hil.HilError, match=f"{path}: object is not .* objects stand at plant, controller, network.sc.law"):
        hil.run("dc-motor-hinf", duration="1 s", **{path: object()})


def test_an_argument_near_to_one_of_the_function_is_suggested() -> None:
    with pytest.raises(HilError, match=r"hil\.sweep: no argument is called 'grids'; did you mean 'grid'\?"):
        hil.sweep("dc-motor-hinf", grids={"plant.gain": [150, 170]})
    with pytest.raises(HilError, match=r"duraton.*did you mean 'duration'"):
        hil.sweep("dc-motor-hinf", duraton=3)


def test_a_point_of_a_sweep_runs_at_its_own_value_beside_a_change_of_the_same_field() -> None:
    given: dict[str, Any] = {"duration": 3, "plant.gain": 160, "network.sc.law.kind": "markov"}
    found = hil.sweep("dc-motor-hinf", grid={"plant.gain": [150, 170], "duration": [1, 2]}, runs=1, jobs=1, **given)
    alone = [hil.sweep("dc-motor-hinf", runs=1, jobs=1, duration=2, **{"plant.gain": gain}) for gain in (150, 170)]
    assert [found.columns[i]["sse"][0] for i in (1, 3)] == [each.values["sse"][0] for each in alone]
    assert found.columns[0]["sse"][0] != found.columns[1]["sse"][0]


def test_a_change_of_what_an_object_stands_for_is_refused() -> None:
    changes: dict[str, Any] = {"plant": DCMotor(gain=140.0), "plant.gain": 20}
    with pytest.raises(hil.HilError, match=r"plant\.gain: has no effect, an object stands at plant"):
        hil.load_experiment("dc-motor-hinf", **changes)
    with pytest.raises(hil.HilError, match=r"plant\.gain: has no effect, an object stands at plant"):
        hil.sweep("dc-motor-hinf", grid={"plant.gain": [150, 170]}, runs=1, jobs=1, plant=DCMotor(gain=140.0))
