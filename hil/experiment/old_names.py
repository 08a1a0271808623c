"""Fields under the names that they had before: files and logs of then are read, what is written has the new names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

NEW_NAMES: Final = {"limits": {"watchdog_ticks": "watchdog_slots"}}
"""Table to old name to new name."""


def new_path(keys: list[str]) -> list[str]:
    """Return the path of a field under its new name.

    >>> new_path(["limits", "watchdog_ticks"])
    ['limits', 'watchdog_slots']
    """
    if len(keys) < 2:
        return keys
    return [keys[0], NEW_NAMES.get(keys[0], {}).get(keys[1], keys[1]), *keys[2:]]


def with_new_names(raw: Mapping[str, Any]) -> dict[str, Any]:
    """Return the tables of an experiment under the new names; an old name beside its new one stays, and is an unknown field."""
    found = dict(raw)
    for table, names in NEW_NAMES.items():
        if isinstance(fields := found.get(table), Mapping):
            found[table] = {names.get(k, k) if names.get(k, k) not in fields else k: v for k, v in fields.items()}
    return found
