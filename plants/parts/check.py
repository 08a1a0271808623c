"""What every plant keeps to, as a function that the author of one can run: ``check_plant(MyPlant())``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from plants.errors import PlantError
from plants.parts.linear import Signal, StateSpace

_SEED = 20240229


class _Run(Protocol):
    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None: ...

    def measure(self) -> tuple[float, ...]: ...

    @property
    def state(self) -> tuple[float, ...]: ...

    @property
    def applied(self) -> tuple[float, ...]: ...


class _Plant(Protocol):
    @property
    def inputs(self) -> tuple[Signal, ...]: ...

    @property
    def outputs(self) -> tuple[Signal, ...]: ...

    @property
    def states(self) -> tuple[Signal, ...]: ...

    def model(self) -> StateSpace: ...

    def start(self, rng: np.random.Generator) -> _Run: ...


def check_plant(plant: _Plant, *, period_s: float = 0.01, tolerance: float = 1e-6) -> None:
    """Hold a plant to the contract of the rig, in virtual time.

    Signals have distinct names and units; the model has as many inputs and outputs as the plant; state, measurement and
    applied input are tuples of finite floats of their lengths; the same seed gives the same bits; measuring changes
    nothing; and two advances are one of their sum, within the tolerance.

    Args:
        plant: the plant with the parameters to be checked.
        period_s: sample period in s, at which the plant is advanced 100 times.
        tolerance: of the last point, relative to the size of the state; 0 where a plant is exact to the last bit.

    Raises:
        PlantError: naming the first rule that is broken.
    """
    name = type(plant).__name__
    for what in ("inputs", "outputs", "states"):
        signals: tuple[Signal, ...] = getattr(plant, what)
        _demand(bool(signals), f"{name}.{what}: empty")
        _demand(len({s.name for s in signals}) == len(signals), f"{name}.{what}: a name comes twice")
        for signal in signals:
            _demand(signal.name.isidentifier() and bool(signal.unit), f"{name}.{what}: {signal!r} has no name or no unit")
    m, p, n = len(plant.inputs), len(plant.outputs), len(plant.states)
    model = plant.model()
    _demand(model.B.shape[1] == m, f"{name}.model: {model.B.shape[1]} inputs, expected {m}")
    _demand(model.C.shape[0] == p, f"{name}.model: {model.C.shape[0]} outputs, expected {p}")

    dt_ns = round(period_s * 1e9)
    runs = [plant.start(np.random.default_rng(_SEED)) for _ in range(3)]
    first, second, cut = runs
    commands = np.random.default_rng(_SEED + 1).uniform(-0.01, 0.01, (100, m)).tolist()
    for k, u in enumerate(commands):
        first.advance(dt_ns, u)
        second.advance(dt_ns, u, [0.0] * m)
        cut.advance(dt_ns // 3, u)
        cut.advance(dt_ns - dt_ns // 3, u)
        state, y = first.state, first.measure()
        for what, vector, length in (("state", state, n), ("measure()", y, p), ("applied", first.applied, m)):
            _demand(isinstance(vector, tuple) and len(vector) == length, f"{name}.{what}: {vector!r}, expected {length} entries")
            _demand(all(type(v) is float and math.isfinite(v) for v in vector), f"{name}.{what}: {vector!r}, expected floats")
        _demand(first.measure() == y and first.state == state, f"{name}.measure(): changes the plant at tick {k}")
        _demand(second.state == state, f"{name}.start: same seed, another state at tick {k}")
        size = max(1.0, *(abs(x) for x in state))
        apart = max(abs(a - b) for a, b in zip(cut.state, state))
        _demand(apart <= tolerance * size, f"{name}.advance: cut in two, the state differs by {apart:.3g} at tick {k}")


def _demand(kept: bool, message: str) -> None:
    if not kept:
        raise PlantError(message)
