"""The faults of ``faults.toml``: one replacement in one file each, and the tests that must see it."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
TABLE = Path(__file__).with_name("faults.toml")


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One fault.

    Args:
        name: what goes wrong.
        file: the file that it is put into, from the top of the checkout.
        old: the sound text, which stands once in the file.
        new: the faulty text.
        tests: what pytest is asked to run; one of them must fail.
    """

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]

    def put_into(self, text: str) -> str:
        """Return the file's text with the fault in it.

        Raises:
            ValueError: the sound text does not stand exactly once in the file: the code has moved on.
        """
        found = text.count(self.old)
        if found != 1:
            raise ValueError(f"{self.name}: its text stands {found} times in {self.file}, expected once")
        return text.replace(self.old, self.new)


def faults() -> list[Fault]:
    """Return every fault of the table."""
    return [Fault(**{**entry, "tests": tuple(entry["tests"])}) for entry in tomllib.loads(TABLE.read_text())["fault"]]
