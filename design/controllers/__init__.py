"""What runs inside a loop. Importing this room imports numpy and nothing heavier, because a process that keeps time does.

Each name brings its module when it is first used: a process pays for the controller that it runs, and for no other.
"""

from __future__ import annotations

from importlib import import_module
from typing import Final

_NAMES: Final = {
    "contract": "Controller DistinguishesAges GainTable Gains HistoryGains IntegralAction Known LoopModel ModeSchedule "
    "MultiSampleController Rows RowsOfStays RunningController Sample Selection SeveralSamples SojournDependent "
    "ages_distinguished check_row_sojourns integral_limit integrates packet_samples row_count row_sojourns_distinguished "
    "sojourns_distinguished",
    "gain_rows": "GainIndex feedforward held_exactly nested",
    "historical": "Historical",
    "linear_law": "AgedFeedback AgedRows LinearFeedback LinearLaw OutputFeedback RowsLaw",
    "send_all": "Constant Local PublishedH2 PublishedHinf SendAll",
    "sensor_nodes": "SensorNodes Turns",
}
"""Module to the public names that it brings; `__init__.pyi` has the same ones for type checkers."""

_HOMES = {name: f"design.controllers.{module}" for module, names in _NAMES.items() for name in names.split()}

__all__ = sorted(_HOMES)  # noqa: PLE0605


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
