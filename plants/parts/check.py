"""What every plant keeps to, as a function that the author of one can run: ``check_plant(MyPlant())``."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from plants.errors import PlantError
from plants.parts import DiscreteStateSpace, Matrix, Signal, StateSpace
from plants.parts.exponential import Rows
from plants.parts.protocols import (
    BeyondModel,
    Departure,
    HasCost,
    HasDepartures,
    HasSensorNoise,
    HasStateDelays,
    HasStateHistory,
    JumpPlant,
    MovesOtherwise,
    Plant,
)

if TYPE_CHECKING:
    from plants.parts.semi_markov import JumpModel

_SEED = 20240229
_RUN = {
    "advance": "advance(dt_ns, u, w=()) holds the input u + w for so long",
    "measure": "measure() gives the outputs, a tuple of floats",
    "state": "the state, a tuple of floats",
    "applied": "the input that was commanded last, a tuple of floats",
}
"""What a rig asks of a running plant."""


def check_plant(plant: Plant, *, period_s: float = 0.01, tolerance: float = 1e-6) -> list[str]:
    """Hold a plant to the contract of the rig, in virtual time.

    Signals have distinct names and units; the model has as many inputs and outputs as the plant; state, measurement and
    applied input are tuples of finite floats of their lengths; the same seed gives the same bits; measuring changes
    nothing; two advances are one of their sum, within the tolerance; and a plant with nothing beyond its model is moved by a
    disturbance as by a command.

    Args:
        plant: the plant with the parameters to be checked.
        period_s: sample period in s, at which the plant is advanced 100 times.
        tolerance: of the last point, relative to the size of the state; 0 where a plant is exact to the last bit.

    Returns:
        Which protocols of :mod:`plants.parts.protocols` the plant fulfils and what each earns, a sentence each.

    Raises:
        PlantError: naming the first rule that is broken.
    """
    name = type(plant).__name__
    for what in ("inputs", "outputs", "states"):
        signals: tuple[Signal, ...] = getattr(plant, what)
        right = isinstance(signals, tuple | list) and all(hasattr(s, "name") and hasattr(s, "unit") for s in signals)
        _demand(right, f"{name}.{what}: {signals!r:.80}, expected a tuple of plants.Signal, such as (Signal('force', 'N'),)")
        _demand(bool(signals), f"{name}.{what}: empty")
        _demand(len({s.name for s in signals}) == len(signals), f"{name}.{what}: a name comes twice")
        for signal in signals:
            texts = isinstance(signal.name, str) and isinstance(signal.unit, str)
            said = f"{name}.{what}: {signal!r}, expected a name of letters, digits and _, and a unit ('1' for a pure number)"
            _demand(texts and signal.name.isidentifier() and bool(signal.unit), said)
    m, p, n = len(plant.inputs), len(plant.outputs), len(plant.states)
    model = plant.model()
    known = all(hasattr(model, matrix) for matrix in "ABC")
    _demand(known, f"{name}.model(): {model!r:.80}, expected a plants.StateSpace")
    _demand(model.B.shape[1] == m, f"{name}.model: {model.B.shape[1]} inputs, expected {m}")
    _demand(model.C.shape[0] == p, f"{name}.model: {model.C.shape[0]} outputs, expected {p}")

    dt_ns = round(period_s * 1e9)
    _takes(plant.start, f"{name}.start(rng)", None)
    runs = [plant.start(np.random.default_rng(_SEED)) for _ in range(4)]
    for what, meaning in _RUN.items():
        _demand(hasattr(runs[0], what), f"what {name}.start(rng) returns needs `{what}` ({meaning})")
    for given in (("dt_ns", "u"), ("dt_ns", "u", "w")):
        _takes(runs[0].advance, f"what {name}.start(rng) returns: advance(dt_ns, u, w=()) must work with and without w", *given)
    first, second, cut, disturbed = runs
    alike = not (isinstance(plant, BeyondModel) and plant.beyond_model())
    commands = np.random.default_rng(_SEED + 1).uniform(-0.01, 0.01, (100, m)).tolist()
    for k, u in enumerate(commands):
        first.advance(dt_ns, u)
        second.advance(dt_ns, u, [0.0] * m)
        cut.advance(dt_ns // 3, u)
        cut.advance(dt_ns - dt_ns // 3, u)
        state, y = first.state, first.measure()
        for what, vector, length in (("state", state, n), ("measure()", y, p), ("applied", first.applied, m)):
            right = isinstance(vector, tuple) and len(vector) == length
            _demand(right, f"{name}.{what}: {vector!r}, expected a tuple of {length}")
            _demand(all(type(v) is float and math.isfinite(v) for v in vector), f"{name}.{what}: {vector!r}, expected floats")
        _demand(first.measure() == y and first.state == state, f"{name}.measure(): changes the plant in slot {k}")
        _demand(second.state == state, f"{name}.start: same seed, another state in slot {k}")
        size = max(1.0, *(abs(x) for x in state))
        apart = max(abs(a - b) for a, b in zip(cut.state, state))
        steps = "integrate in short steps inside, by Runge-Kutta (hil guide own-plant-law-controller)"
        said = f"{name}.advance: a slot in one step and in two ends in states that differ by {apart:.3g} (slot {k}); {steps}"
        _demand(apart <= tolerance * size, said)
        disturbed.advance(dt_ns, [0.0] * m, u)
        apart = max(abs(a - b) for a, b in zip(disturbed.state, state))
        said = f"{name}.advance: w moves the state by {apart:.3g} otherwise than u (slot {k}); hold u + w, or name beyond_model()"
        _demand(apart <= tolerance * size or not alike, said)
    return [f"{name} is a Plant: a rig can run it, and a design can be made for its model", *_further(plant, name)]


def _takes(call: Callable[..., object], rule: str, *arguments: object) -> None:
    try:
        inspect.signature(call).bind(*arguments)
    except TypeError as error:
        raise PlantError(f"{rule}: {error}") from error
    except ValueError:  # a compiled function may have no signature
        pass


def _further(plant: Plant, name: str) -> list[str]:
    said = []
    if isinstance(plant, JumpPlant):
        system, process = plant.jump_system(), plant.jump_process()
        _check_jumps(system, name, inputs=len(plant.inputs), outputs=len(plant.outputs))
        modes = len(system.A)
        _demand(process.rates.modes == modes, f"{name}.jump_process: rates of {process.rates.modes} modes, expected {modes}")
        seen = {table.modes for table in process.detection}
        detections = len(process.detection)
        _demand(detections in (0, modes), f"{name}.jump_process: {detections} detections, expected {modes}")
        _demand(len(seen) <= 1, f"{name}.jump_process: detections of {sorted(seen)} modes, expected one number")
        said.append(f"{name} is a JumpPlant: robust-scheduled gains can be solved for its modes, and their loop be judged")
    else:
        said.append(f"{name} is no JumpPlant (no jump_system and jump_process): its loops are judged by its linear model")
    if isinstance(plant, BeyondModel):
        beyond = plant.beyond_model()
        _demand(
            isinstance(beyond, tuple) and all(isinstance(each, str) and each for each in beyond),
            f"{name}.beyond_model(): {beyond!r}, expected a tuple of noun phrases",
        )
        what = f"it has {', '.join(beyond)}, so a claim on its model is undecided for it" if beyond else "now it has nothing"
        said.append(f"{name} is BeyondModel: it states the effects that its model lacks; {what}")
    if isinstance(plant, MovesOtherwise):
        moves, sees = plant.motion(), plant.model()
        _demand(
            isinstance(moves, StateSpace | DiscreteStateSpace) and (moves.B.shape, moves.C.shape) == (sees.B.shape, sees.C.shape),
            f"{name}.motion(): {moves!r:.80}, expected a StateSpace with the states, inputs and outputs of model()",
        )
    if isinstance(plant, HasDepartures):
        bounded = plant.departures()
        good = isinstance(bounded, tuple) and all(isinstance(each, Departure) for each in bounded)
        _demand(good, f"{name}.departures(): {bounded!r:.80}, expected a tuple of plants.Departure")
    if isinstance(plant, HasStateDelays):
        delayed = np.asarray(plant.state_delays(), dtype=float)
        n = len(plant.states)
        _demand(delayed.shape == (len(delayed), n, n), f"{name}.state_delays(): shape {delayed.shape}, expected (tau, {n}, {n})")
        _demand(bool(np.isfinite(delayed).all()), f"{name}.state_delays(): not finite")
        said.append(f"{name} is HasStateDelays: gains over historical data can be solved for its {len(delayed)} delayed states")
    if isinstance(plant, HasCost):
        sizes = (len(plant.states), len(plant.inputs))
        for what, weight, size in zip(("Xi", "Xi_u"), plant.cost_weights(), sizes):
            _check_weight(np.asarray(weight, dtype=float), size, f"{name}.cost_weights(): {what}")
        said.append(f"{name} is HasCost: designs over historical data and the measure cost weigh by its own weights")
    if isinstance(plant, HasStateHistory):
        history, n = np.asarray(plant.state_history(), dtype=float), len(plant.states)
        fits = history.ndim == 2 and history.shape[1] == n and bool(np.isfinite(history).all())
        _demand(fits, f"{name}.state_history(): shape {history.shape}, expected (h, {n}), finite")
        said.append(f"{name} is HasStateHistory: the cost in a certificate counts what was before slot 0")
    if isinstance(plant, HasSensorNoise):
        deviations, p = np.asarray(plant.sensor_noise(), dtype=float), len(plant.outputs)
        fits = deviations.shape == (p,) and bool((np.isfinite(deviations) & (deviations >= 0)).all())
        _demand(fits, f"{name}.sensor_noise(): {deviations.tolist()}, expected {p} finite numbers, at least 0")
        said.append(f"{name} is HasSensorNoise: the certificate of gains over historical data says what it costs")
    return said


def _check_weight(weight: Matrix, size: int, where: str) -> None:
    _demand(weight.shape == (size, size), f"{where} of shape {weight.shape}, expected ({size}, {size})")
    _demand(bool(np.isfinite(weight).all()) and bool((weight == weight.T).all()), f"{where} is not finite and symmetric")
    least = float(np.linalg.eigvalsh(weight)[0])
    _demand(least >= -1e-12 * float(np.abs(weight).max()), f"{where} has the eigenvalue {least:.3g}, expected at least 0")


def _check_jumps(system: JumpModel, name: str, *, inputs: int, outputs: int) -> None:
    modes, n = len(system.A), outputs - 1
    expected = {"A": (n, n), "B": (n, inputs), "C": (None, n), "E": (n, None), "Ad": (n, n), "S": (n, n)}
    tables: dict[str, tuple[Rows, ...]] = {"A": system.A, "B": system.B, "C": system.C, "E": system.E, "Ad": system.Ad}
    tables["S"] = system.S
    for k, (dA, dB) in enumerate(system.changes):
        tables |= {f"changes[{k}][0]": dA, f"changes[{k}][1]": dB}
        expected |= {f"changes[{k}][0]": (n, n), f"changes[{k}][1]": (n, inputs)}
    for what, matrices in tables.items():
        optional = what in ("C", "E", "Ad", "S")
        _demand(len(matrices) == modes > 0 or (optional and not matrices), f"{name}.jump_system: {what} of {len(matrices)} modes")
        for matrix in matrices:
            shape = np.shape(matrix)
            fits = len(shape) == 2 and all(e is None or e == s for e, s in zip(expected[what], shape))
            _demand(fits, f"{name}.jump_system: {what} of shape {shape}; the plant measures {n} states and the mode")
            _demand(bool(np.isfinite(matrix).all()), f"{name}.jump_system: {what} is not finite")
    least, most = system.min_delay_s, system.max_delay_s
    _demand(0.0 <= least <= most, f"{name}.jump_system: min_delay_s {least:g}, expected 0 to max_delay_s ({most:g})")
    slopes = len(system.delay_slopes)
    _demand(slopes == (modes if system.Ad else slopes), f"{name}.jump_system: {slopes} delay_slopes, expected {modes}")


def _demand(kept: bool, message: str) -> None:
    if not kept:
        raise PlantError(message)
