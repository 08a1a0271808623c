"""Data is frozen, has slots and takes its fields by name; what does not is named here."""

from __future__ import annotations

import importlib
import pkgutil
from collections import defaultdict
from collections.abc import Iterator

import msgspec

from tests.changed import PACKAGES

FILLED_IN = {
    "CanNode", "Content", "Draft", "LinkCounters", "LmiProgram", "Participant", "PumpReport", "RealOutcome", "Recovery",
    "Refusals", "Samples", "Trip", "Waiting", "_Packet", "_Packets",
}  # fmt: skip
"""As it comes, by those who gather it."""

OPEN = {"CanNode", "DesignResult", "Waiting", "_Packet"}
"""To attributes that are no fields."""

IN_ORDER = {
    "AgePath", "Approximately", "Between", "BitRates", "BusStatus", "CanNode", "Check", "Claim", "Draft", "Drawn", "Equals",
    "FirstIdentifiers", "GainParametrisation", "Layout", "Line", "Lines", "LinkCounters", "LmiProgram", "LoopStructure",
    "MessageTable", "NotJudged", "Page", "Place", "RealOutcome", "Refusals", "Samples", "Stage", "Statement", "Sweep", "Trip",
    "Turn", "Waiting", "Weight", "Wish", "_Packet", "_Packets", "_Point",
}  # fmt: skip
"""Made of values whose order is as plain as their names."""


def data() -> Iterator[tuple[type, bool]]:
    """Give the classes of data, and whether each is a struct."""
    for package in PACKAGES:
        for each in pkgutil.walk_packages([package], f"{package}."):
            module = importlib.import_module(each.name) if not each.name.endswith("__main__") else msgspec
            for cls in vars(module).values():
                if isinstance(cls, type) and cls.__module__ == each.name:
                    struct = issubclass(cls, msgspec.Struct)
                    if struct or "__dataclass_params__" in vars(cls):
                        yield cls, struct


def test_data_is_frozen_has_slots_and_takes_its_fields_by_name() -> None:
    names: dict[str, set[str]] = defaultdict(set)
    for cls, struct in data():
        frozen = (cls.__struct_config__ if struct else cls.__dataclass_params__).frozen
        lacks = {"filled in": not frozen, "open": not struct and "__slots__" not in vars(cls), "in order": cls.__match_args__}
        for what, is_so in lacks.items():
            names[what] |= {cls.__name__} if is_so else set()
    known = {"filled in": FILLED_IN, "open": OPEN, "in order": IN_ORDER}
    assert {what: sorted(found - known[what]) for what, found in names.items()} == {what: [] for what in known}
