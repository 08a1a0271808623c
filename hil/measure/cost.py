"""What a run cost: the quadratic cost of its states and inputs, and what its sensors put on the network."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import ClassVar

import numpy as np

from hil.log.append_column import pieces
from hil.log.topics import SC, SENSOR, STATE
from hil.measure import Quantity
from hil.measure.batch_protocols import BatchView
from hil.measure.network_paths import loads, node_loads
from hil.measure.signals import Array, Signals
from hil.measure.view import APPLIED, RunView, matrix, signal_names
from plants.parts.protocols import HasCost


class Cost:
    """The sum over all slots of x' Xi x + u' Xi_u u, and packets and bits per second from sensors to controller."""

    title: ClassVar[str] = "Cost and network load"
    note: ClassVar[str] = (
        "The weights are the plant's own; for a plant without weights they are the unit matrix. The load counts sensor packets "
        "as they were sent, lost ones included, with their headers."
    )
    topics: ClassVar[tuple[str, ...]] = (STATE.name, APPLIED, SENSOR.name, SC.name)

    def quantities(self, signals: Signals) -> tuple[Quantity, ...]:
        """Return what is measured; inputs of several units have no largest one."""
        unit = signals.input_unit()
        return (
            Quantity(name="cost", title="cost J", note="sum over all slots", per_output=False),
            *([] if unit is None else [Quantity(name="peak_input", title="largest input", unit=unit, per_output=False)]),
            Quantity(name="packets_per_s", title="sensor packets", unit="1/s", per_output=False),
            Quantity(name="bits_per_s", title="sensor bits", unit="bit/s", per_output=False),
        )

    def of(self, view: RunView) -> dict[str, float | None]:
        """Return the numbers of one run."""
        names = signal_names(view.run, STATE.name)
        plant = view.experiment.plant if view.experiment is not None else None
        weights = _weights(plant, len(names), len(view.signals.inputs))
        states = (matrix(piece, names) for piece in pieces(view.run.arrays[STATE.name]))
        found = view.once(loads)
        numbers = {
            **_of_one(states, view.inputs(), weights),
            "packets_per_s": sum(load.packets_per_s for load in found) if found else None,
            "bits_per_s": sum(load.bits_per_s for load in found) if found else None,
        }
        return {q.name: numbers[q.name] for q in self.quantities(view.signals)}

    def of_batch(self, view: BatchView) -> Mapping[str, Array]:
        """Return the numbers of many runs, see `BatchMeasure.of_batch`."""
        weights = _weights(view.experiment.plant, len(view.states), len(view.inputs))
        rows = []
        for run in range(len(view.inputs[0])):
            x, u = (np.column_stack([signal[run] for signal in signals]) for signals in (view.states, view.inputs))
            rows.append(_of_one(pieces(x), pieces(u), weights))
        found = {name: np.array([np.nan if row[name] is None else row[name] for row in rows]) for name in ("cost", "peak_input")}
        sent = np.zeros((0, len(rows)), dtype=np.int64) if view.packets is None else view.packets
        per_node = [node_loads(view.rig, column, len(view.t_s) * view.period_s) for column in sent.T.tolist()]
        found["packets_per_s"] = np.array([sum(load.packets_per_s for load in own) for own in per_node])
        found["bits_per_s"] = np.array([sum(load.bits_per_s for load in own) for own in per_node])
        return {q.name: found[q.name] for q in self.quantities(view.signals)}


def _weights(plant: object, n: int, m: int) -> tuple[Array, Array]:
    return plant.cost_weights() if isinstance(plant, HasCost) else (np.eye(n), np.zeros((m, m)))


def _of_one(
    states: Iterable[Array], inputs: Iterable[Array],
    weights: tuple[Array, Array],
) -> dict[str, float | None]:  # fmt: skip
    """Return the cost and the largest input of one run, its states (k, n) and inputs (k, m) piece by piece."""
    weight, input_weight = weights
    squares, peaks = [], []
    with np.errstate(over="ignore", invalid="ignore"):
        total = sum(_square(piece, weight) for piece in states)
        for u in inputs:
            squares.append(_square(u, input_weight))
            peaks += [float(np.abs(u).max())] if u.size else []
        total += sum(squares)
    largest = float(np.max(peaks)) if peaks else None  # NaN where one is
    return {
        "cost": total if np.isfinite(total) else None,
        "peak_input": largest if largest is not None and np.isfinite(largest) else None,
    }


def _square(z: Array, weight: Array) -> float:
    """Return the sum over k of z_k' W z_k, in one order on every machine."""
    total = 0.0
    for a, row in enumerate(weight.tolist()):
        for b, w in enumerate(row):
            total += w * float(np.sum(z[:, a] * z[:, b])) if w else 0.0
    return total
