"""The table `limits`: what the rig allows, whatever the controller does."""

from __future__ import annotations

import typing
from typing import Any

import msgspec

from hil.experiment.table import Seconds, Table, not_negative


class Passivity(Table, frozen=True, kw_only=True):
    """A passivity controller at the rig: it observes the energy that the motor gives, at the device, without the network.

    Counted is what the motor gives beyond what the damping of device and hand takes, as their model says; it needs a plant that
    takes one force and measures the position that it acts on.

    Args:
        damping_n_s_per_m: largest damping that it injects while too much was given, in the plant's unit; 0 for none. A damper
            that is held over a sample period T is no damper beyond about 2 m/T.
        energy_j: what may be given before it damps, in J; the rounding of packets feigns less than a microjoule.
        trip_j: what trips the safe state when given, in J; never by default.
    """

    damping_n_s_per_m: float = 0.0
    energy_j: float = 1e-6
    trip_j: float | None = None

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        damping, trip = values.get("damping_n_s_per_m", 0.0), values.get("trip_j")
        if damping < 0:
            yield f"damping_n_s_per_m: {damping:g} is negative"
        elif damping == 0 and trip is None:
            yield "damping_n_s_per_m: the passivity controller neither damps nor trips; give a damping, or trip_j"
        if values.get("energy_j", 0.0) < 0:
            yield f"energy_j: {values['energy_j']:g} is negative"
        if trip is not None and trip <= 0:
            yield f"trip_j: {trip:g} is not positive"


class Limits(Table, frozen=True, kw_only=True):
    """What the rig allows, whatever the controller does; a violation latches the safe state (zero input).

    Args:
        watchdog_slots: so many slots in a row without a usable command trip the watchdog.
        input: largest absolute command per input, in the input's unit.
        state: largest absolute value of named states, in the state's unit.
        after_trip: how long the rig goes on in the safe state before the run ends.
        passivity: damping, or a trip, on the energy that the motor gives; off without the table.
    """

    watchdog_slots: int = 3
    input: tuple[float, ...] | None = None
    state: dict[str, float] = msgspec.field(default_factory=dict)
    after_trip: Seconds = typing.cast(Seconds, 1.0)  # a plain float, for the JSON Schema
    passivity: Passivity | None = None

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        if values.get("watchdog_slots", 1) < 1:
            yield f"watchdog_slots: {values['watchdog_slots']} is below 1"
        for i, bound in enumerate(values.get("input") or ()):
            if bound <= 0:
                yield f"input[{i}]: {bound:g} is not positive"
        for name, bound in values.get("state", {}).items():
            if bound <= 0:
                yield f"state.{name}: {bound:g} is not positive"
        yield from not_negative(values, "after_trip")
