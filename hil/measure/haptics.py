"""What a hand felt at a virtual wall: depth, force, and the energy that the wall gave away."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from hil.log.append_column import whole
from hil.log.topics import STATE
from hil.measure import Quantity
from hil.measure.signals import Array, Signals
from hil.measure.view import APPLIED, MEASUREMENT, RunView

LAST_SHARE = 0.1
"""Last share of the run over which the final depth is averaged."""


class Haptics:
    """Depth of the device behind the surface, force of the motor, and the passivity observer of a held device."""

    title: ClassVar[str] = "Haptics"
    note: ClassVar[str] = (
        "The wall begins at position 0. Energy given is that of the motor minus that of the damping: 0 behind a safe coupler, "
        "but for what is stored where the device begins behind the surface."
    )
    topics: ClassVar[tuple[str, ...]] = (MEASUREMENT, APPLIED, STATE.name)

    def quantities(self, signals: Signals) -> tuple[Quantity, ...]:
        """Return what is measured."""
        length, force = _length(signals)[1], signals.input_unit() or ""
        return (
            Quantity(name="final_depth", title="final depth", unit=length, note="mean of the last tenth", per_output=False),
            Quantity(name="largest_depth", title="largest depth", unit=length, per_output=False),
            Quantity(name="depth_spread", title="spread of the depth", unit=length, note="last tenth, sd", per_output=False),
            Quantity(name="largest_force", title="largest force", unit=force, per_output=False),
            Quantity(name="energy_given", title="energy given by the wall", unit="mJ", note="largest", per_output=False),
        )

    def of(self, view: RunView) -> dict[str, float | None]:
        """Return the numbers of one run."""
        name = view.signals.tracked[0]
        depth = _length(view.signals)[0] * _finite(whole(view.run.arrays[MEASUREMENT], name))
        force = _finite(np.abs(view.applied()))
        last = depth[-max(round(LAST_SHARE * depth.size), 1) :]
        states = view.run.arrays[STATE.name]
        given = _finite(whole(states, "given") if "given" in (states.dtype.names or ()) else np.zeros(0))
        return {
            "final_depth": float(last.mean()) if last.size else None,
            "largest_depth": float(depth.max()) if depth.size else None,
            "depth_spread": float(last.std()) if last.size else None,
            "largest_force": float(force.max()) if force.size else None,
            "energy_given": 1e3 * float(given.max()) if given.size else None,
        }


def _finite(values: Array) -> Array:
    return values[np.isfinite(values)]


def _length(signals: Signals) -> tuple[float, str]:
    """Return what a depth is multiplied by, and its unit then: metres are shown in millimetres, as on the curves."""
    unit = signals.tracked_unit() or ""
    return (1e3, "mm") if unit == "m" else (1.0, unit)
