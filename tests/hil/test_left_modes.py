"""A plant that jumps and leaves the matrices of its modes in the run loses the certificate; one that keeps to them does not."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.special import pdtrc

from hil.api.experiment_source import load_experiment
from hil.compose import compose
from hil.compose.judged import NOT_COMPARED
from hil.rig.loop import JumpStep, Loop
from hil.runtime.nodes.jump_watch import FEW, UNLIKELY, JumpWatch, _too_many
from hil.runtime.nodes.plant_watch import BLOCK
from hil.session import simulated_session
from plants import SwitchedExample
from plants.vtol_fault import FaultyVTOL
from tests.hil.test_left_model import said, sums_of

FROM = 900
Lie = Callable[[list[float], Sequence[float], int], list[float]]
LIES: dict[str, Lie] = {
    "a pole": lambda x, u, mode: [1.02 * v for v in x],
    "a pole of the first mode": lambda x, u, mode: [1.02 * v for v in x] if mode == 1 else x,
    "the input": lambda x, u, mode: [x[0] - 0.05 * u[0], *x[1:]],
    "a state that is no number": lambda x, u, mode: [float("nan"), *x[1:]],
    "what both states are": lambda x, u, mode: [1.02 * v for v in x] if x[0] * x[1] > 0 else [0.98 * v for v in x],
}


class Bent:
    """A run that moves otherwise from a slot on."""

    def __init__(self, run: Any, lie: Lie) -> None:
        self.run, self.lie, self.slots = run, lie, 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.run, name)

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        self.run.advance(dt_ns, u, w)
        self.slots += 1
        if self.slots > FROM:
            self.run._x = self.lie(list(self.run._x), u, int(self.run.measure()[-1]))


NOW: dict[str, Callable[[Any], Any]] = {}
"""What becomes of the runs that start; nothing: they keep to their modes."""


@cache
def composed(cls: type[Any], slots: int = 1500) -> Loop:
    """Compose the loop of a plant that `NOW` bends, with a pulse at its input."""
    name, period, inputs = CASES[cls]
    own = type(f"Own{cls.__name__}", (cls,), {"start": lambda self, rng: NOW.get("run", lambda run: run)(cls.start(self, rng))})
    plant = load_experiment(name).plant
    made = own(**{f.name: getattr(plant, f.name) for f in fields(plant)})  # type: ignore[arg-type]
    pulse = [{"at": "0.5 s", "samples": 100, "value": [0.3] * inputs}]
    return compose(load_experiment(name, plant=made, duration=slots * period, disturbance=pulse, **{"limits.state": {}}))


CASES = {SwitchedExample: ("smjls-robust", 0.005, 1), FaultyVTOL: ("vtol-fault", 0.001, 2)}
"""Experiment, period in s, disturbances: all measured and none noisy; hidden modes and gusts."""


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize("cls", CASES)
def test_a_plant_that_leaves_its_modes_late_loses_the_certificate(
    cls: type[Any], lie: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = composed(cls)
    monkeypatch.setitem(NOW, "run", lambda run: Bent(run, LIES[lie]))
    assert loop.verdict is not None and loop.verdict.certified and NOT_COMPARED not in loop.verdict.assumptions
    reported = said(simulated_session(loop, 2))
    assert reported.startswith("certificate withdrawn: the plant left its model at slot "), reported
    assert FROM <= int(reported.split(" slot ")[1].split()[0]) < 1500


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("cls", CASES)
def test_one_that_keeps_to_its_modes_keeps_the_certificate(cls: type[Any], seed: int) -> None:
    loop = composed(cls)
    assert loop.watched is not None and isinstance(loop.watched.plant, JumpStep)
    assert not said(simulated_session(loop, seed))


class Coarse:
    """A run that is exact in a slot, and no more where it is to go many at once; it counts how often it goes."""

    gone = 0

    def __init__(self, run: Any, share: float) -> None:
        self.run, self.share = run, share

    def __getattr__(self, name: str) -> Any:
        return getattr(self.run, name)

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        self.run.advance(dt_ns, u, w)
        Coarse.gone += 1
        if dt_ns > 20_000_000:
            self.run._x = [(1.0 + self.share) * v for v in self.run._x]


@pytest.mark.parametrize("share", [0.0, 1e-3])
def test_a_long_second_run_goes_many_slots_at_once_and_what_it_finds_is_looked_at_in_every_slot(
    share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = composed(FaultyVTOL, 4000)
    monkeypatch.setitem(NOW, "run", lambda run: Coarse(run, share))
    monkeypatch.setattr(Coarse, "gone", 0)
    assert not said(simulated_session(loop, 2))
    assert Coarse.gone < 4500 if not share else Coarse.gone > 8000  # slots of the run, 4000, and those of the second one


def test_a_plant_with_noise_that_leaves_its_modes_after_a_long_time_loses_the_certificate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(globals(), "FROM", 3500)
    loop = composed(FaultyVTOL, 4000)
    monkeypatch.setitem(NOW, "run", lambda run: Bent(run, LIES["the input"]))
    reported = said(simulated_session(loop, 2))
    assert reported.startswith("certificate withdrawn: the plant left its model at slot 35"), reported


@pytest.mark.parametrize(("scale", "kept"), [(1.0, True), (3.0, False)])
def test_uncertain_matrices_may_vary_within_their_bounds_and_not_beyond(scale: float, kept: bool) -> None:
    loop = composed(SwitchedExample)
    watched, wide = loop.watched, replace(loop.experiment.plant, uncertainty="sampled", uncertainty_scale=scale)  # type: ignore[type-var]
    assert watched is not None and isinstance(watched.plant, JumpStep)

    def start() -> Any:
        return wide.start(np.random.default_rng(4))

    watch, run = JumpWatch(watched.plant, start, 5_000_000), start()
    for k in range(500):
        u = (0.2 * (-1) ** (k // 7),)
        watch.take(run.state, run.measure(), u, (0.0,))
        run.advance(5_000_000, u, (0.0,))
    assert (watch.departed() is None) is kept


class OneState:
    """x(k+1) = a x(k) + u(k), in one mode."""

    def __init__(self, a: float) -> None:
        self._a, self.state = a, (0.0,)

    def measure(self) -> tuple[float, float]:
        return self.state[0], 1.0

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        self.state = (self._a * self.state[0] + u[0],)


@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e9])
@pytest.mark.parametrize(("a", "kept"), [(0.5, True), (0.5001, False)])
def test_a_plant_is_judged_alike_in_whatever_unit_its_states_are(unit: float, a: float, kept: bool) -> None:
    step = JumpStep(flows=np.array([[[0.5, 1.0]]]), bands=np.zeros((1, 1, 2)), seen=True, unseen=0.0, names=(("x", "m"),))
    watch, run = JumpWatch(step, lambda: OneState(a), 1_000_000), OneState(a)  # type: ignore[arg-type, return-value]
    for k in range(2 * BLOCK):
        u = (unit * (-1) ** (k // 7),)
        watch.take(run.state, run.measure(), u, (0.0,))
        run.advance(1_000_000, u)
    assert (watch.departed() is None) is kept


def test_a_mode_that_commands_change_is_named_with_the_slot_in_which_it_did() -> None:
    plant, watched = composed(SwitchedExample).experiment.plant, composed(SwitchedExample).watched
    assert watched is not None and isinstance(watched.plant, JumpStep)

    def start() -> Any:
        return plant.start(np.random.default_rng(4))

    watch, run = JumpWatch(watched.plant, start, 5_000_000), start()
    for k in range(3 * BLOCK):
        *y, mode = run.measure()
        other = 1 + int(mode) % len(watched.plant.flows)
        watch.take(run.state, (*y, other if k >= BLOCK + 40 else mode), (0.2,), (0.0,))
        run.advance(5_000_000, (0.2,), (0.0,))
    assert watch.departed() == (BLOCK + 40, "a mode that its inputs change")


def test_no_slot_waits_until_a_block_of_a_plant_that_jumps_is_compared(monkeypatch: pytest.MonkeyPatch) -> None:
    loop = composed(SwitchedExample)
    assert loop.watched is not None and isinstance(loop.watched.plant, JumpStep)
    sums = sums_of(monkeypatch)
    run, in_slot = loop.experiment.plant.start(np.random.default_rng(4)), []
    watch = JumpWatch(loop.watched.plant, lambda: pytest.fail("a plant that keeps to its modes is not run again"), 5_000_000)
    for _ in range(2 * BLOCK):
        before = len(sums)
        watch.take(run.state, run.measure(), (0.1,), (0.0,))
        in_slot.append(len(sums) - before)
        run.advance(5_000_000, (0.1,), (0.0,))
    assert max(in_slot) <= 3 < 20 < sum(in_slot) and not any(in_slot[: BLOCK - 1])
    assert watch.departed() is None and len(sums) > 40


@pytest.mark.parametrize("mean", [0.0, 1e-6, 1e-3, 0.1, 1.0, 10.0])
def test_slots_that_miss_are_too_many_where_jumps_that_were_not_seen_would_hardly_be_so_many(mean: float) -> None:
    """Beside the tail of Poisson's law: Chernoff's bound is no smaller, and for so few at most 20 times as large."""
    for count in range(60):
        chance = float(pdtrc(count - 1, mean)) if count else 1.0
        if count <= FEW or chance > UNLIKELY:
            assert not _too_many(count, mean)
        if count > FEW and chance < UNLIKELY / 20.0:
            assert _too_many(count, mean)
