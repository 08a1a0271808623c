"""What a run cost: the quadratic cost of its states and inputs, and what its sensors put on the network."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from hil.experiment.protocols import HasCost
from hil.log.growing import pieces
from hil.measure.measure import Quantity
from hil.measure.network_load import loads
from hil.measure.signals import Signals
from hil.measure.view import APPLIED, RunView, matrix, signal_names

STATE, SENSOR, DRAWS = "/plant/state", "/link/sensor", "/network/sc"


class Cost:
    """The sum over all slots of x' Xi x + u' Xi_u u, and packets and bits per second from sensors to controller."""

    title: ClassVar[str] = "Cost and network load"
    note: ClassVar[str] = (
        "The weights are the plant's own; for a plant without weights they are the unit matrix. The load counts sensor packets "
        "as they were sent, lost ones included, with their headers."
    )
    topics: ClassVar[tuple[str, ...]] = (STATE, APPLIED, SENSOR, DRAWS)

    def quantities(self, signals: Signals) -> tuple[Quantity, ...]:
        """Return what is measured."""
        return (
            Quantity(name="cost", title="cost J", note="sum over all slots", per_output=False),
            Quantity(name="peak_input", title="largest input", unit=signals.input_unit() or "", per_output=False),
            Quantity(name="packets_per_s", title="sensor packets", unit="1/s", per_output=False),
            Quantity(name="bits_per_s", title="sensor bits", unit="bit/s", per_output=False),
        )

    def of(self, view: RunView) -> dict[str, float | None]:
        """Return the numbers of one run."""
        names = signal_names(view.run, STATE)
        n, m = len(names), len(view.signals.inputs)
        plant = view.experiment.plant if view.experiment is not None else None
        weight, input_weight = plant.cost_weights() if isinstance(plant, HasCost) else (np.eye(n), np.zeros((m, m)))
        with np.errstate(over="ignore", invalid="ignore"):
            total = sum(_square(matrix(piece, names), weight) for piece in pieces(view.run.arrays[STATE]))
            total += sum(_square(u, input_weight) for u in view.inputs())
        found = loads(view)
        peaks = [float(np.abs(u).max()) for u in view.inputs() if u.size]
        largest = float(np.max(peaks)) if peaks else None  # NaN where one is
        return {
            "cost": total if np.isfinite(total) else None,
            "peak_input": largest if largest is not None and np.isfinite(largest) else None,
            "packets_per_s": sum(load.packets_per_s for load in found) if found else None,
            "bits_per_s": sum(load.bits_per_s for load in found) if found else None,
        }


def _square(z: npt.NDArray[np.float64], weight: npt.NDArray[np.float64]) -> float:
    """Return the sum over k of z_k' W z_k."""
    return float(np.einsum("ka,ab,kb->", z, weight, z))
